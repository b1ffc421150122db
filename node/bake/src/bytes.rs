//! Plain numbers and slices to bytes and back, for the files of the working folder.
//!
//! What is read back was written by this program on this machine, but perhaps not to the end: every
//! length is checked against what is there.

use bytemuck::Pod;

/// The bytes end too early, or say something that cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the record is torn")]
pub(crate) struct Torn;

impl From<Torn> for std::io::Error {
    fn from(torn: Torn) -> Self {
        Self::new(std::io::ErrorKind::InvalidData, torn)
    }
}

/// Appends values.
#[derive(Debug, Default)]
pub(crate) struct Encoder(pub(crate) Vec<u8>);

impl Encoder {
    /// One number or record.
    pub(crate) fn put<T: Pod>(&mut self, value: T) {
        self.0.extend_from_slice(bytemuck::bytes_of(&value));
    }

    /// A length and so many records.
    pub(crate) fn put_slice<T: Pod>(&mut self, values: &[T]) {
        self.put(values.len() as u64);
        self.0.extend_from_slice(bytemuck::cast_slice(values));
    }

    /// A text.
    pub(crate) fn put_text(&mut self, text: &str) {
        self.put_slice(text.as_bytes());
    }
}

/// Takes values from the front.
#[derive(Debug)]
pub(crate) struct Decoder<'a>(pub(crate) &'a [u8]);

impl<'a> Decoder<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], Torn> {
        let (front, rest) = self.0.split_at_checked(count).ok_or(Torn)?;
        self.0 = rest;
        Ok(front)
    }

    /// One number or record.
    pub(crate) fn take<T: Pod>(&mut self) -> Result<T, Torn> {
        Ok(bytemuck::pod_read_unaligned(self.bytes(size_of::<T>())?))
    }

    /// A length and so many records.
    pub(crate) fn take_slice<T: Pod>(&mut self) -> Result<Vec<T>, Torn> {
        let count = self.take_count()?;
        let bytes = self.bytes(count.checked_mul(size_of::<T>()).ok_or(Torn)?)?;
        Ok(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect())
    }

    /// A text.
    pub(crate) fn take_text(&mut self) -> Result<String, Torn> {
        String::from_utf8(self.take_slice()?).map_err(|_| Torn)
    }

    /// A number of things to come, each at least a byte long.
    pub(crate) fn take_count(&mut self) -> Result<usize, Torn> {
        let count = usize::try_from(self.take::<u64>()?).map_err(|_| Torn)?;
        if count <= self.0.len() { Ok(count) } else { Err(Torn) }
    }

    /// Nothing may be left.
    pub(crate) fn end(self) -> Result<(), Torn> {
        if self.0.is_empty() { Ok(()) } else { Err(Torn) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_and_every_torn_end_is_noticed() {
        let mut out = Encoder::default();
        out.put(7u32);
        out.put_slice(&[1.5f64, -2.0]);
        out.put_text("wall");
        let read = |bytes: &[u8]| -> Result<_, Torn> {
            let mut from = Decoder(bytes);
            let all = (from.take::<u32>()?, from.take_slice::<f64>()?, from.take_text()?);
            from.end().map(|()| all)
        };
        assert_eq!(read(&out.0), Ok((7, vec![1.5, -2.0], "wall".to_owned())));
        assert!((0..out.0.len()).all(|end| read(&out.0[..end]).is_err()));
        out.put(0u8);
        assert!(read(&out.0).is_err());
    }

    #[test]
    fn a_claimed_length_allocates_nothing() {
        let mut out = Encoder::default();
        out.put(u64::MAX / 8);
        assert_eq!(Decoder(&out.0).take_slice::<f64>(), Err(Torn));
        assert_eq!(Decoder(&out.0).take_count(), Err(Torn));
    }
}
