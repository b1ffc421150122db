//! Bytes that are read a range at a time: a file, or what was decoded from one.

use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::Mutex;

use super::open::open;

trait ReadSeek: Read + Seek + Send {}

impl<T: Read + Seek + Send> ReadSeek for T {}

/// Bytes that any thread may read ranges of, without all of them being in memory.
pub(super) struct Store {
    bytes: Mutex<Box<dyn ReadSeek>>,
    length: u64,
}

impl Store {
    /// A regular file.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        Self::new(open(path)?)
    }

    /// Bytes that are in memory.
    pub(super) fn memory(bytes: Vec<u8>) -> Self {
        let length = bytes.len() as u64;
        Self { bytes: Mutex::new(Box::new(Cursor::new(bytes))), length }
    }

    /// Whatever can be read from any place.
    pub(super) fn new(mut bytes: impl Read + Seek + Send + 'static) -> io::Result<Self> {
        let length = bytes.seek(SeekFrom::End(0))?;
        Ok(Self { bytes: Mutex::new(Box::new(bytes)), length })
    }

    /// How many bytes there are.
    pub(super) fn length(&self) -> u64 {
        self.length
    }

    /// `length` bytes at `start`. Nothing is allocated for bytes that are not there.
    pub(super) fn read(&self, start: u64, length: usize) -> io::Result<Vec<u8>> {
        if start.checked_add(length as u64).is_none_or(|end| end > self.length) {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let mut out = vec![0; length];
        // Each read begins with a seek, so a thread that died in between left no harm.
        let mut bytes = self.bytes.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        bytes.seek(SeekFrom::Start(start))?;
        bytes.read_exact(&mut out)?;
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_and_those_beyond_the_end_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        std::fs::write(&path, b"0123456789").unwrap();
        for store in [Store::memory(b"0123456789".to_vec()), Store::open(&path).unwrap()] {
            assert_eq!(store.length(), 10);
            assert_eq!(store.read(7, 3).unwrap(), b"789");
            assert_eq!(store.read(0, 2).unwrap(), b"01");
            assert_eq!(store.read(10, 0).unwrap(), b"");
            for (start, length) in [(8, 3), (11, 0), (0, usize::MAX), (u64::MAX, 2)] {
                let error = store.read(start, length).unwrap_err();
                assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
            }
        }
        assert!(Store::open(folder.path()).is_err());
    }
}
