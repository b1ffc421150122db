//! Arithmetic coding of yes-or-no decisions whose odds both ends know.
//!
//! A decision divides the present interval by its odds, so a string of decisions of joint
//! probability p ends as an interval of width p, and is told by -log2 p bits (Rissanen 1976). Integers
//! only: both ends divide alike on every machine.

/// Bits of the window in which the interval is held; a byte leaves it once it is settled.
const WINDOW: u32 = 56;
/// The interval is never narrower than this after a decision.
const NARROW: u64 = 1 << (WINDOW - 8);

/// One end of a code: the writer is told each decision, the reader tells it.
pub(super) trait Decide {
    /// Decides with odds of `share` in `total` for yes, `0 < share < total`. The writer codes `wanted` and
    /// returns it; the reader does not look at it.
    fn decide(&mut self, wanted: bool, share: u64, total: u64) -> bool;
}

/// The part of `range` that is for yes; never nothing and never all.
fn divide(range: u64, share: u64, total: u64) -> u64 {
    let part = u128::from(range) * u128::from(share) / u128::from(total);
    // The quotient is below `range`, since `share` is below `total`.
    (part as u64).clamp(1, range - 1)
}

/// Takes decisions, gives bytes.
#[derive(Debug)]
pub(super) struct Writer {
    settled: Vec<u8>,
    low: u64,
    range: u64,
}

impl Writer {
    /// Nothing is decided yet.
    pub(super) fn new() -> Self {
        Self { settled: Vec::new(), low: 0, range: 1 << WINDOW }
    }

    /// The bytes, and how many bits of them the decisions take: the fewest whose every continuation
    /// lies in the interval, so that nothing behind them matters. The rest of the last byte is zero.
    ///
    /// A 64th of the interval is left unused (0.023 bits): `divide` and the odds are rounded, and no set
    /// of decisions is to cost less than its odds say.
    pub(super) fn finish(mut self) -> (Vec<u8>, u32) {
        self.range -= self.range >> 6;
        let end = self.low + self.range;
        let settled_bits = 8 * self.settled.len() as u32;
        let fits = |&bits: &u32| {
            let step = 1u64 << (WINDOW - bits);
            self.low.next_multiple_of(step) + step <= end
        };
        let bits = (0..WINDOW).find(fits).unwrap_or(WINDOW);
        let value = self.low.next_multiple_of(1 << (WINDOW - bits));

        if value >> WINDOW != 0 {
            self.carry();
        }
        let bytes = bits.div_ceil(8) as usize;
        let window = (value << (64 - WINDOW)).to_be_bytes();
        self.settled.extend(&window[..bytes]);
        (self.settled, settled_bits + bits)
    }

    /// Adds one to the settled bytes. The whole lies below 1, so there is a byte that takes it.
    fn carry(&mut self) {
        for byte in self.settled.iter_mut().rev() {
            *byte = byte.wrapping_add(1);
            if *byte != 0 {
                return;
            }
        }
    }
}

impl Decide for Writer {
    fn decide(&mut self, wanted: bool, share: u64, total: u64) -> bool {
        let yes = divide(self.range, share, total);
        if wanted {
            self.range = yes;
        } else {
            self.low += yes;
            self.range -= yes;
        }
        if self.low >> WINDOW != 0 {
            self.carry();
            self.low &= (1 << WINDOW) - 1;
        }
        while self.range <= NARROW {
            self.settled.push((self.low >> (WINDOW - 8)) as u8);
            self.low = self.low << 8 & ((1 << WINDOW) - 1);
            self.range <<= 8;
        }
        wanted
    }
}

/// Takes bytes, gives decisions. Any bytes are read: behind their end come zeros.
#[derive(Debug)]
pub(super) struct Reader<'a> {
    left: std::slice::Iter<'a, u8>,
    /// The code less the interval's lower end.
    value: u64,
    range: u64,
}

impl<'a> Reader<'a> {
    /// Starts at the first byte.
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let mut reader = Self { left: bytes.iter(), value: 0, range: 1 << WINDOW };
        (0..WINDOW / 8).for_each(|_| reader.shift());
        reader
    }

    fn shift(&mut self) {
        self.value = self.value << 8 | u64::from(self.left.next().copied().unwrap_or(0));
    }
}

impl Decide for Reader<'_> {
    fn decide(&mut self, _wanted: bool, share: u64, total: u64) -> bool {
        let yes = divide(self.range, share, total);
        let decided = self.value < yes;
        if decided {
            self.range = yes;
        } else {
            self.value -= yes;
            self.range -= yes;
        }
        while self.range <= NARROW {
            self.range <<= 8;
            self.shift();
        }
        decided
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn nothing_decided_takes_a_bit() {
        assert_eq!(Writer::new().finish(), (vec![0], 1));
    }

    #[test]
    fn even_odds_take_a_bit_and_sure_things_hardly_any() {
        let mut even = Writer::new();
        for i in 0..80 {
            even.decide(i % 3 == 0, 1, 2);
        }
        assert!((80..=82).contains(&even.finish().1));
        let mut sure = Writer::new();
        for _ in 0..1000 {
            sure.decide(true, 999_999, 1_000_000);
        }
        assert!(sure.finish().1 <= 2);
    }

    #[test]
    fn a_carry_runs_through_settled_bytes() {
        // Half, less a sliver again and again: the lower end comes up to just below a half, then passes it.
        let mut writer = Writer::new();
        let decisions: Vec<bool> = (0..60).map(|i| i == 0 || i == 59).collect();
        for &decision in &decisions {
            writer.decide(decision, 1, 2);
        }
        let (bytes, _) = writer.finish();
        let mut reader = Reader::new(&bytes);
        assert!(decisions.iter().all(|&decision| reader.decide(false, 1, 2) == decision));
    }

    proptest! {
        #[test]
        fn decisions_come_back_whatever_follows(
            decisions in proptest::collection::vec((any::<bool>(), 1u64..1 << 40, 1u64..1 << 40), 0..200),
            behind: Vec<u8>,
        ) {
            let mut writer = Writer::new();
            for &(wanted, share, more) in &decisions {
                writer.decide(wanted, share, share + more);
            }
            let (mut bytes, bits) = writer.finish();
            prop_assert_eq!(bytes.len(), bits.div_ceil(8) as usize);
            // What fills the last byte, and what comes behind it, tells nothing.
            if let (Some(last), true) = (bytes.last_mut(), bits % 8 != 0) {
                *last |= 0xff >> (bits % 8);
            }
            bytes.extend(behind);
            let mut reader = Reader::new(&bytes);
            for &(wanted, share, more) in &decisions {
                prop_assert_eq!(reader.decide(false, share, share + more), wanted);
            }
        }
    }
}
