//! Which k of n positions: every choice equally likely, so each costs log2 C(n, k) bits.
//!
//! The positions are halved again and again, and of the k it is coded how many lie in the lower
//! half: j with probability C(a, j) C(b, k-j) / C(n, k), a and b being the halves' sizes. The factors
//! of one choice multiply to 1 / C(n, k). A half with none of the k, or full of them, says nothing more,
//! so the work is about k log n, and does not grow with the scene.
//!
//! The numbers are far beyond any float, and must not differ between machines. So j is coded as a walk
//! away from the likeliest one, whose odds at each step are the ratio of a term to the sum of those
//! beyond it: fixed-point numbers from 1 to k, relative errors below 2^-14 even in the last step of the
//! thinnest tail.

use super::interval::{Decide, Reader, Writer};

/// One, in the fixed point of sums of terms; they stay below `ONE * k`, `k < 2^16`.
const ONE: u64 = 1 << 32;

/// Codes which of the `of` positions 0, 1, ... are `chosen`, rising.
pub(super) fn write(chosen: &[u32], of: u64, to: &mut Writer) {
    let mut written = Vec::with_capacity(chosen.len());
    walk(to, Range { from: 0, size: of, count: chosen.len() as u64 }, Some(chosen), &mut written);
}

/// The `count <= of` positions that were chosen; from bytes that no writer wrote, any others.
pub(super) fn read(from: &mut Reader<'_>, count: u64, of: u64) -> Vec<u32> {
    let mut chosen = Vec::with_capacity(count as usize);
    walk(from, Range { from: 0, size: of, count }, None, &mut chosen);
    chosen
}

/// A run of positions, and how many of them are chosen.
struct Range {
    from: u64,
    size: u64,
    count: u64,
}

/// Decides for a range. `known` is what the writer wants, the reader has none; both append to `chosen`.
fn walk(end: &mut impl Decide, range: Range, known: Option<&[u32]>, chosen: &mut Vec<u32>) {
    let Range { from, size, count } = range;
    if count == size {
        chosen.extend((from..from + size).map(|position| position as u32));
    }
    if count == 0 || count == size {
        return;
    }

    let (lower, upper) = (size / 2, size - size / 2);
    let middle = from + lower;
    let wanted = known
        .map_or(0, |known| known.partition_point(|&position| u64::from(position) < middle) as u64);
    let below = in_lower_half(end, Halves { lower, upper, count }, wanted);
    let known = known.map(|known| known.split_at(below as usize));

    let half = Range { from, size: lower, count: below };
    walk(end, half, known.map(|(first, _)| first), chosen);
    let half = Range { from: middle, size: upper, count: count - below };
    walk(end, half, known.map(|(_, last)| last), chosen);
}

/// The two halves of a range and how many of both together are chosen.
struct Halves {
    lower: u64,
    upper: u64,
    count: u64,
}

impl Halves {
    /// Fewest and most that the lower half can have.
    fn limits(&self) -> (u64, u64) {
        (self.count.saturating_sub(self.upper), self.count.min(self.lower))
    }

    /// The likeliest number in the lower half: the hypergeometric distribution's mode.
    fn mode(&self) -> u64 {
        let (a, k) = (u128::from(self.lower) + 1, u128::from(self.count) + 1);
        let mode = a * k / (u128::from(self.lower + self.upper) + 2);
        let (least, most) = self.limits();
        (mode as u64).clamp(least, most)
    }

    /// `tail` times the term of `j + 1` over that of `j`.
    fn times_step_up(&self, j: u64, tail: u64) -> u64 {
        let numerator = (self.lower - j) * (self.count - j);
        let denominator = (j + 1) * (self.upper + j + 1 - self.count);
        scale(tail, numerator, denominator)
    }

    /// `tail` times the term of `j - 1` over that of `j`.
    fn times_step_down(&self, j: u64, tail: u64) -> u64 {
        let numerator = j * (self.upper + j - self.count);
        let denominator = (self.lower + 1 - j) * (self.count + 1 - j);
        scale(tail, numerator, denominator)
    }
}

/// `tail * numerator / denominator`, at least 1: what can be is never given no odds.
fn scale(tail: u64, numerator: u64, denominator: u64) -> u64 {
    let scaled = u128::from(tail) * u128::from(numerator) / u128::from(denominator);
    (scaled as u64).max(1)
}

/// Decides how many of the chosen lie in the lower half.
fn in_lower_half(end: &mut impl Decide, halves: Halves, wanted: u64) -> u64 {
    let (least, most) = halves.limits();
    let mode = halves.mode();

    // Sums of the terms from one number on to the end, in units of the first of them.
    let mut up = vec![ONE];
    for j in (mode..most).rev() {
        up.push(ONE + halves.times_step_up(j, up[up.len() - 1]));
    }
    let mut down = vec![ONE];
    for j in least + 1..=mode {
        down.push(ONE + halves.times_step_down(j, down[down.len() - 1]));
    }
    let from_mode_up = up[up.len() - 1];
    let below_mode = down[down.len() - 1] - ONE;

    // Which side, then step by step: is it this number, or one further out?
    if below_mode == 0 || end.decide(wanted >= mode, from_mode_up, from_mode_up + below_mode) {
        let mut j = mode;
        while j < most && !end.decide(wanted == j, ONE, up[(most - j) as usize]) {
            j += 1;
        }
        return j;
    }
    let mut j = mode - 1;
    while j > least && !end.decide(wanted == j, ONE, down[(j - least) as usize]) {
        j -= 1;
    }
    j
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visible::entropy_bound_bits;
    use rand::rngs::StdRng;
    use rand::seq::index::sample;
    use rand::{Rng, SeedableRng};

    /// Bits of a choice, after reading it back.
    fn bits(chosen: &[u32], of: u64) -> u32 {
        let mut writer = Writer::new();
        write(chosen, of, &mut writer);
        let (bytes, bits) = writer.finish();
        assert_eq!(read(&mut Reader::new(&bytes), chosen.len() as u64, of), chosen);
        bits
    }

    #[test]
    fn none_and_all_are_told_by_their_number() {
        for of in [0u32, 1, 2, 7, 300] {
            assert_eq!(bits(&[], u64::from(of)), 1);
            assert_eq!(bits(&(0..of).collect::<Vec<_>>(), u64::from(of)), 1);
        }
    }

    /// Every choice there is, of few: none costs less than the bound, none more than 1.1 bits beyond a
    /// whole number of them.
    #[test]
    fn every_choice_costs_its_bound() {
        for of in 1..=12u32 {
            for mask in 0u32..1 << of {
                let chosen: Vec<u32> = (0..of).filter(|i| mask >> i & 1 == 1).collect();
                let bound = entropy_bound_bits(u64::from(of), chosen.len() as u64);
                let bits = f64::from(bits(&chosen, u64::from(of)));
                assert!((bound..bound + 2.1).contains(&bits), "{chosen:?} of {of}: {bits} {bound}");
            }
        }
    }

    /// What lies side by side, or at one end, costs as much as what is spread: the code has no tails
    /// in which it is cheaper than it should be.
    #[test]
    fn the_unlikeliest_choices_cost_their_bound_too() {
        for of in [1u32 << 10, 1_000, 99_999, u32::MAX] {
            for count in [1u32, 2, 3, 17, 100, 512] {
                for from in [0, 1, of / 2 - count / 2, of / 3, of - count] {
                    let chosen: Vec<u32> = (from..from + count).collect();
                    let bound = entropy_bound_bits(u64::from(of), u64::from(count));
                    let bits = f64::from(bits(&chosen, u64::from(of)));
                    assert!(
                        (bound..bound + 2.2).contains(&bits),
                        "{count} of {of}: {bits} {bound}"
                    );
                }
            }
        }
    }

    #[test]
    fn choices_by_chance_cost_their_bound() {
        let mut rng = StdRng::seed_from_u64(1);
        for _ in 0..2_000 {
            let of = 1 << rng.random_range(0..20u32);
            let count = rng.random_range(0..=512.min(of));
            let mut chosen: Vec<u32> =
                sample(&mut rng, of, count).iter().map(|i| i as u32).collect();
            chosen.sort_unstable();
            let bound = entropy_bound_bits(of as u64, count as u64);
            let bits = f64::from(bits(&chosen, of as u64));
            assert!((bound..bound + 2.1).contains(&bits), "{count} of {of}: {bits} {bound}");
        }
    }

    #[test]
    fn any_bytes_are_read_as_some_choice() {
        let mut rng = StdRng::seed_from_u64(2);
        for _ in 0..2_000 {
            let of = rng.random_range(0..=u64::from(u32::MAX)) >> rng.random_range(0..32u32);
            let count = rng.random_range(0..=of.min(600));
            let bytes: Vec<u8> = (0..rng.random_range(0..40)).map(|_| rng.random()).collect();
            let chosen = read(&mut Reader::new(&bytes), count, of);
            assert_eq!(chosen.len() as u64, count);
            assert!(chosen.is_sorted_by(|a, b| a < b));
            assert!(chosen.last().is_none_or(|&last| u64::from(last) < of));
        }
    }
}
