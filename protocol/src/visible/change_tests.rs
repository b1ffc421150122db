//! Round trips, damage, golden bytes, and size against the bound.

use super::*;
use proptest::prelude::*;
use rand::rngs::StdRng;
use rand::seq::index::sample;
use rand::{Rng, SeedableRng};
use std::collections::BTreeSet;

/// Hlods of the largest scene.
const MOST: u32 = u32::MAX;

fn set(ids: impl IntoIterator<Item = u32>) -> VisibleSet {
    let sorted: BTreeSet<u32> = ids.into_iter().collect();
    VisibleSet::from_sorted(sorted.into_iter().map(HlodId).collect())
}

fn write(
    base: &VisibleSet,
    next: &VisibleSet,
    hlods: u32,
    part: usize,
) -> (Vec<DeltaChunk>, ChangeTotals) {
    let mut chunks = Vec::new();
    let mut writer = ChangeWriter::new(Arc::new(base.clone()), hlods);
    for ids in next.ids().chunks(part) {
        writer.push(ids[ids.len() - 1], ids, &mut chunks);
    }
    let (written, totals) = writer.finish(&mut chunks);
    assert_eq!(&written, next);
    assert!(f64::from(totals.code_bits) >= totals.bound_bits, "{totals:?}");
    (chunks, totals)
}

fn read(base: &VisibleSet, chunks: &[DeltaChunk], hlods: u32) -> Result<VisibleSet, ChangeError> {
    let mut reader = ChangeReader::new(Arc::new(base.clone()), hlods);
    chunks.iter().try_for_each(|chunk| reader.push(chunk))?;
    Ok(reader.finish())
}

#[test]
fn no_change_costs_nothing() {
    for same in [set([]), set([0]), set([MOST - 1]), set(5..500)] {
        assert_eq!(write(&same, &same, MOST, 7), (vec![], ChangeTotals::default()));
        assert_eq!(read(&same, &[], MOST).unwrap(), same);
    }
    assert_eq!(write(&set([]), &set([]), 0, 1), (vec![], ChangeTotals::default()));
}

#[test]
fn the_extremes_round_trip() {
    let sets = [
        set([]),
        set([0]),
        set([MOST - 1]),
        set([0, MOST - 1]),
        set([MOST - 2, MOST - 1]),
        set(0..3000),
    ];
    for base in &sets {
        for next in &sets {
            let (chunks, totals) = write(base, next, MOST, 100);
            assert_eq!(&read(base, &chunks, MOST).unwrap(), next);
            let named = |count: fn(&DeltaChunk) -> u16| {
                chunks.iter().map(|chunk| u32::from(count(chunk))).sum::<u32>()
            };
            assert_eq!(totals.leaving, named(|chunk| chunk.leaving));
            assert_eq!(totals.entering, named(|chunk| chunk.entering));
        }
    }
}

#[test]
fn a_small_change_is_one_chunk_and_a_large_one_streams() {
    let base = set((0..4000).map(|i| i * 3));
    let next = set((0..4000).map(|i| if i % 20 == 0 { i * 3 + 1 } else { i * 3 }));
    assert_eq!(write(&base, &next, 20_000, 50).0.len(), 1);
    assert_eq!(write(&base, &set([]), 20_000, 50).0.len(), 4000usize.div_ceil(CHUNK_IDS));
}

/// Both ends of another build must read these bytes alike.
#[test]
fn a_change_keeps_its_bytes() {
    let (chunks, totals) = write(&set([1, 5, 9, 20]), &set([1, 6, 9, 30, 31]), 100, 9);
    let code = chunks[0].code.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    assert_eq!((chunks[0].through, chunks[0].leaving, chunks[0].entering), (HlodId(99), 2, 3));
    assert_eq!((code.as_str(), totals.code_bits, totals.chunk_bytes), ("930db0", 21, 11));
    // log2 C(4, 2) + log2 C(96, 3).
    assert!((totals.bound_bits - (6f64.log2() + 142_880f64.log2())).abs() < 1e-9);
}

#[test]
fn impossible_chunks_are_refused() {
    let base = set([1, 2, 3]);
    let push = |through, leaving, entering, code: &[u8]| {
        let through = HlodId(through);
        read(&base, &[DeltaChunk { through, leaving, entering, code: code.to_vec() }], 2000)
    };
    assert_eq!(push(1999, 0, 0, &[]), Err(ChangeError::BadCount));
    assert_eq!(push(1999, 4, 0, &[]), Err(ChangeError::BadCount));
    assert_eq!(push(0, 0, 2, &[]), Err(ChangeError::BadCount));
    assert_eq!(push(1999, 0, 513, &[]), Err(ChangeError::BadCount));
    assert_eq!(push(2000, 1, 0, &[]), Err(ChangeError::NoSuchId));
    let (good, _) = write(&base, &set([1, 2]), 2000, 9);
    assert_eq!(read(&base, &good, 2000), Ok(set([1, 2])));
    assert_eq!(read(&base, &[good[0].clone(), good[0].clone()], 2000), Err(ChangeError::NoSuchId));
    for damage in [&[][..], &[0x80][..], &[good[0].code[0], 0], &[good[0].code[0] | 1]] {
        let chunk = DeltaChunk { code: damage.to_vec(), ..good[0].clone() };
        assert_eq!(read(&base, &[chunk], 2000), Err(ChangeError::BadCode), "{damage:?}");
    }
}

/// A walk of `changed` ids a frame, `run` many side by side: bits of code, and the bound.
fn walk_cost(total: u32, visible: u32, changed: u32, run: u32) -> [f64; 2] {
    let mut rng = StdRng::seed_from_u64(u64::from(changed + run));
    let ids = sample(&mut rng, total as usize, visible as usize);
    let mut base = set(ids.iter().map(|i| i as u32));
    let mut cost = [0.0; 2];
    for _ in 0..60 {
        let mut ids: BTreeSet<u32> = base.ids().iter().map(|id| id.0).collect();
        for i in 0..changed.div_ceil(run) {
            // Half of the changes leave, so that the set keeps its size.
            let leaves = !base.is_empty() && (i + rng.random_range(0..2)) % 2 == 0;
            let start = if leaves {
                base.ids()[rng.random_range(0..base.len())].0
            } else {
                rng.random_range(0..total)
            };
            for id in start..(start + run).min(total) {
                let _ = if leaves { ids.remove(&id) } else { ids.insert(id) };
            }
        }
        let next = set(ids);
        let (chunks, totals) = write(&base, &next, total, 64);
        assert_eq!(read(&base, &chunks, total).unwrap(), next);
        cost[0] += f64::from(totals.code_bits);
        cost[1] += totals.bound_bits;
        if chunks.len() == 1 && totals.leaving + totals.entering < CHUNK_IDS as u32 {
            // The plain formula, from the counts alone.
            let (size, others) = (base.len() as u64, u64::from(total) - base.len() as u64);
            let plain = entropy_bound_bits(size, u64::from(totals.leaving))
                + entropy_bound_bits(others, u64::from(totals.entering));
            assert!((plain - totals.bound_bits).abs() < 1e-6);
        }
        base = next;
    }
    cost
}

/// A frame pays up to two bits beyond its bound, so a walk of three changes of 20,000 ids or more stays
/// within a twentieth.
#[test]
fn a_walk_costs_at_most_a_twentieth_more_than_the_bound() {
    for (total, visible) in
        [(1000, 100), (1000, 500), (5000, 400), (20_000, 1000), (120_000, 4000), (200_000, 4000)]
    {
        for changed in [1, 2, 3, 5, 10, 30, 100, 300, 2000] {
            for run in [1, 4] {
                let [bits, bound] = walk_cost(total, visible, changed, run);
                println!("N {total} V {visible} k {changed} run {run}: {:.4}", bits / bound);
                assert!(bits >= bound, "N {total} k {changed} run {run}: {bits} {bound}");
                let most = if bound >= 60.0 * 40.0 { 1.05 * bound } else { bound + 120.0 };
                assert!(bits <= most, "N {total} k {changed} run {run}: {bits} {bound}");
            }
        }
    }
}

proptest! {
    #[test]
    fn any_change_round_trips(base: BTreeSet<u32>, next: BTreeSet<u32>, shift in 1u32..31, part in 1usize..80) {
        let (base, next) = (set(base.iter().map(|id| id >> shift)), set(next.iter().map(|id| id >> shift)));
        let hlods = 1 << (32 - shift);
        let (chunks, _) = write(&base, &next, hlods, part);
        prop_assert_eq!(read(&base, &chunks, hlods).unwrap(), next);
    }

    #[test]
    fn any_bytes_are_read_without_panic(
        base: BTreeSet<u32>,
        shift in 1u32..31,
        hlods: u32,
        chunks: Vec<(u32, u16, u16, Vec<u8>)>,
    ) {
        let base = set(base.iter().map(|id| id >> shift));
        let chunk = |(through, leaving, entering, code)| DeltaChunk {
            through: HlodId(through >> shift),
            leaving: leaving >> (shift / 2),
            entering: entering >> (shift / 2),
            code,
        };
        let chunks: Vec<_> = chunks.into_iter().map(chunk).collect();
        if let Ok(next) = read(&base, &chunks, hlods) {
            prop_assert!(next.len() <= base.len() + CHUNK_IDS * chunks.len());
        }
    }
}
