//! Bits, and an adaptive Rice code for gaps.
//!
//! Gaps between independent changes are geometric, for which Golomb's code is optimal (Gallager and
//! van Voorhis 1975); Rice's powers of two lose about 0.03 bits a gap. Both ends learn the mean gap
//! from what was coded before, so no parameter travels.

/// Quotients from here on are sent as this many ones and the plain 32-bit gap.
const ESCAPE: u32 = 24;
/// How many gaps the first guess of the mean counts for.
const PRIOR_WEIGHT: u64 = 4;
/// After this many gaps the older ones count half.
const WINDOW: u64 = 32;

/// Packs bits, least significant first.
#[derive(Debug, Default)]
pub(super) struct BitWriter {
    bytes: Vec<u8>,
    used: u32,
}

impl BitWriter {
    /// Appends the low `count` bits of `bits`; `count <= 32`.
    pub(super) fn put(&mut self, bits: u32, count: u32) {
        for i in 0..count {
            if self.used == 0 {
                self.bytes.push(0);
            }
            if let Some(last) = self.bytes.last_mut() {
                *last |= ((bits >> i & 1) as u8) << self.used;
            }
            self.used = (self.used + 1) % 8;
        }
    }

    /// The bytes, the last one padded with zeros, or left out where it is zero altogether: the
    /// length travels anyway, so it may as well tell something.
    pub(super) fn into_bytes(mut self) -> Vec<u8> {
        self.bytes.pop_if(|last| *last == 0);
        self.bytes
    }
}

/// Unpacks what [`BitWriter`] packed.
#[derive(Debug)]
pub(super) struct BitReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> BitReader<'a> {
    /// Starts at the first bit.
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// The next `count <= 32` bits; none past the end, where one more byte of zeros is meant.
    pub(super) fn take(&mut self, count: u32) -> Option<u32> {
        let mut bits = 0;
        for i in 0..count {
            let byte = match self.at / 8 {
                end if end == self.bytes.len() => 0,
                index => *self.bytes.get(index)?,
            };
            bits |= u32::from(byte >> (self.at % 8) & 1) << i;
            self.at += 1;
        }
        Some(bits)
    }

    /// Only the zeros that fill the last byte are left.
    pub(super) fn ends_here(mut self) -> bool {
        let left = (self.bytes.len() * 8).saturating_sub(self.at);
        left < 8 && self.take(left as u32) == Some(0)
    }
}

/// What has been learnt of the gaps of one list.
#[derive(Debug, Clone)]
pub(super) struct GapModel {
    sum: u64,
    count: u64,
}

impl GapModel {
    /// Starts from a guess of the mean gap.
    pub(super) fn new(mean: u32) -> Self {
        Self { sum: u64::from(mean) * PRIOR_WEIGHT, count: PRIOR_WEIGHT }
    }

    /// Codes `gap`.
    pub(super) fn write(&mut self, gap: u32, out: &mut BitWriter) {
        let low_bits = self.parameter();
        let quotient = gap >> low_bits;
        if quotient >= ESCAPE {
            out.put((1 << ESCAPE) - 1, ESCAPE);
            out.put(gap, 32);
        } else {
            out.put((1 << quotient) - 1, quotient + 1);
            out.put(gap, low_bits);
        }
        self.learn(gap);
    }

    /// The next gap; none where the bits end or no writer would have written them.
    pub(super) fn read(&mut self, from: &mut BitReader<'_>) -> Option<u32> {
        let low_bits = self.parameter();
        let mut quotient = 0;
        while quotient < ESCAPE && from.take(1)? == 1 {
            quotient += 1;
        }
        let gap = if quotient == ESCAPE {
            from.take(32).filter(|gap| gap >> low_bits >= ESCAPE)?
        } else {
            let high = u64::from(quotient) << low_bits;
            u32::try_from(high).ok()? | from.take(low_bits)?
        };
        self.learn(gap);
        Some(gap)
    }

    /// Low bits sent plainly: floor(log2(0.962 mean)), the optimum for geometric gaps (Kiely 2004,
    /// "Selecting the Golomb parameter in Rice coding", with ln of the golden ratio * 2 = 0.962).
    fn parameter(&self) -> u32 {
        (self.sum * 31 / 32 / self.count).max(1).ilog2().min(31)
    }

    fn learn(&mut self, gap: u32) {
        self.sum += u64::from(gap);
        self.count += 1;
        if self.count >= WINDOW {
            self.sum /= 2;
            self.count /= 2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn no_bits_make_no_bytes() {
        assert!(BitWriter::default().into_bytes().is_empty());
        assert!(BitReader::new(&[]).ends_here());
        assert_eq!(BitReader::new(&[]).take(9), None);
    }

    #[test]
    fn a_last_byte_of_zeros_is_left_out_but_only_one() {
        let mut out = BitWriter::default();
        out.put(1, 17);
        let bytes = out.into_bytes();
        assert_eq!(bytes, [1, 0]);
        let mut reader = BitReader::new(&bytes);
        assert_eq!(reader.take(24), Some(1));
        assert_eq!(reader.take(1), None);
    }

    #[test]
    fn padding_must_be_zero_and_short() {
        assert!(!BitReader::new(&[0]).ends_here());
        let mut reader = BitReader::new(&[0b1000_0001]);
        assert_eq!(reader.take(1), Some(1));
        assert!(!reader.ends_here());
    }

    #[test]
    fn an_outlier_costs_at_most_56_bits() {
        let mut out = BitWriter::default();
        GapModel::new(0).write(u32::MAX, &mut out);
        assert_eq!(out.into_bytes().len(), 7);
    }

    proptest! {
        #[test]
        fn gaps_round_trip(mean: u32, gaps: Vec<u32>, shift in 0u32..32) {
            let gaps: Vec<u32> = gaps.iter().map(|gap| gap >> shift).collect();
            let mut out = BitWriter::default();
            let mut model = GapModel::new(mean);
            gaps.iter().for_each(|&gap| model.write(gap, &mut out));
            let bytes = out.into_bytes();
            let mut reader = BitReader::new(&bytes);
            let mut model = GapModel::new(mean);
            for &gap in &gaps {
                prop_assert_eq!(model.read(&mut reader), Some(gap));
            }
            prop_assert!(reader.ends_here());
        }
    }
}
