//! Round trips, damage, and size against the entropy bound.

use super::*;
use crate::visible::entropy_bound_bits;
use proptest::prelude::*;
use rand::rngs::StdRng;
use rand::seq::index::sample;
use rand::{Rng, SeedableRng};
use std::collections::BTreeSet;

fn set(ids: impl IntoIterator<Item = u32>) -> VisibleSet {
    let sorted: BTreeSet<u32> = ids.into_iter().collect();
    VisibleSet::from_sorted(sorted.into_iter().map(HlodId).collect())
}

fn write(base: &VisibleSet, next: &VisibleSet, part: usize) -> (Vec<DeltaChunk>, ChangeTotals) {
    let mut chunks = Vec::new();
    let mut writer = ChangeWriter::new(Arc::new(base.clone()));
    for ids in next.ids().chunks(part) {
        writer.push(ids[ids.len() - 1], ids, &mut chunks);
    }
    let (written, totals) = writer.finish(&mut chunks);
    assert_eq!(&written, next);
    (chunks, totals)
}

fn read(base: &VisibleSet, chunks: &[DeltaChunk]) -> Result<VisibleSet, ChangeError> {
    let mut reader = ChangeReader::new(Arc::new(base.clone()));
    chunks.iter().try_for_each(|chunk| reader.push(chunk))?;
    Ok(reader.finish())
}

#[test]
fn no_change_costs_nothing() {
    for same in [set([]), set([0]), set([u32::MAX]), set(5..500)] {
        assert_eq!(write(&same, &same, 7), (vec![], ChangeTotals::default()));
        assert_eq!(read(&same, &[]).unwrap(), same);
    }
}

#[test]
fn the_extremes_round_trip() {
    let sets = [
        set([]),
        set([0]),
        set([u32::MAX]),
        set([0, u32::MAX]),
        set([u32::MAX - 1, u32::MAX]),
        set(0..3000),
    ];
    for base in &sets {
        for next in &sets {
            let (chunks, totals) = write(base, next, 100);
            assert_eq!(&read(base, &chunks).unwrap(), next);
            assert_eq!(totals.changed, chunks.iter().map(|chunk| chunk.count).sum::<u32>());
        }
    }
}

#[test]
fn a_small_change_is_one_chunk_and_a_large_one_streams() {
    let base = set((0..4000).map(|i| i * 3));
    let next = set((0..4000).map(|i| if i % 20 == 0 { i * 3 + 1 } else { i * 3 }));
    assert_eq!(write(&base, &next, 50).0.len(), 1);
    assert_eq!(write(&base, &set([]), 50).0.len(), 4000usize.div_ceil(CHUNK_IDS));
}

#[test]
fn impossible_chunks_are_refused() {
    let base = set([1, 2, 3]);
    let push = |count, code: &[u8]| read(&base, &[DeltaChunk { count, code: code.to_vec() }]);
    assert_eq!(push(0, &[]), Err(ChangeError::BadCount));
    assert_eq!(push(9, &[]), Err(ChangeError::BadCode));
    assert_eq!(push(u32::MAX, &[0; 4]), Err(ChangeError::BadCode));
    // Two bits for a count of 2: 3 of 2 leave.
    assert_eq!(push(2, &[0b11]), Err(ChangeError::BadCount));
    // One leaves, gap 5 of three.
    assert_eq!(push(1, &[0b011_1111]), Err(ChangeError::NoSuchId));
    let (mut chunks, _) = write(&base, &set([1, 2]), 9);
    chunks[0].code.push(0);
    assert_eq!(read(&base, &chunks), Err(ChangeError::BadCode));
}

/// A walk of `changed` ids a frame, `run` many side by side: bytes, bound in bytes, and the bound with
/// every frame's rounded up to whole bytes.
fn walk_cost(total: u32, visible: u32, changed: u32, run: u32) -> [f64; 3] {
    let mut rng = StdRng::seed_from_u64(u64::from(changed + run));
    let ids = sample(&mut rng, total as usize, visible as usize);
    let mut base = set(ids.iter().map(|i| i as u32));
    let mut cost = [0.0; 3];
    for _ in 0..60 {
        let mut ids: BTreeSet<u32> = base.ids().iter().map(|id| id.0).collect();
        for i in 0..changed.div_ceil(run) {
            // Half of the changes leave, so that the set keeps its size.
            let leaves = (i + rng.random_range(0..2)) % 2 == 0;
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
        let (chunks, totals) = write(&base, &next, 64);
        assert_eq!(read(&base, &chunks).unwrap(), next);
        let bound = entropy_bound_bits(u64::from(total), u64::from(totals.changed)) / 8.0;
        cost[0] += f64::from(totals.code_bytes);
        cost[1] += bound;
        cost[2] += bound.ceil();
        base = next;
    }
    cost
}

#[test]
fn a_walk_costs_at_most_a_fifth_more_than_the_entropy_bound() {
    for (total, visible) in
        [(1000, 100), (1000, 500), (5000, 400), (20_000, 1000), (120_000, 4000), (200_000, 4000)]
    {
        for changed in [1, 2, 3, 5, 10, 30, 100, 300, 2000] {
            for run in [1, 4] {
                let [bytes, bound, whole] = walk_cost(total, visible, changed, run);
                let ratio = bytes / bound;
                println!("N {total} V {visible} k {changed} run {run}: {ratio:.3}");
                // No code of whole bytes names one of 1,000 ids in 1.2 times 10 bits.
                assert!(ratio <= 1.2 || bytes <= whole, "N {total} k {changed} run {run}: {ratio}");
            }
        }
    }
}

proptest! {
    #[test]
    fn any_change_round_trips(base: BTreeSet<u32>, next: BTreeSet<u32>, shift in 0u32..31, part in 1usize..80) {
        let (base, next) = (set(base.iter().map(|id| id >> shift)), set(next.iter().map(|id| id >> shift)));
        let (chunks, _) = write(&base, &next, part);
        prop_assert_eq!(read(&base, &chunks).unwrap(), next);
    }

    #[test]
    fn any_bytes_are_read_without_panic(base: BTreeSet<u32>, shift in 0u32..31, chunks: Vec<(u32, Vec<u8>)>) {
        let base = set(base.iter().map(|id| id >> shift));
        let chunks: Vec<_> = chunks
            .into_iter()
            .map(|(count, code)| DeltaChunk { count: count % (code.len() as u32 * 8 + 2), code })
            .collect();
        if let Ok(next) = read(&base, &chunks) {
            prop_assert!(next.len() <= base.len() + chunks.iter().map(|c| c.count as usize).sum::<usize>());
        }
    }
}
