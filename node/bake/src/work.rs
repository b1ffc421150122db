//! The working folder of a bake: `.NAME.bake` beside the output NAME.
//!
//! It holds what every finished stage made, under the digest of what that stage was made from, so that
//! a bake that was cut short goes on where it was. A finished bake removes it. One bake at a time works
//! in it.

use std::fs::{File, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Digest of all that a stage depends on.
pub(crate) type Key = [u8; 32];

/// Why the working folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum WorkError {
    /// Another bake has it.
    #[error("{}: another bake is writing this scene; wait for it or choose another output", path.display())]
    Busy {
        /// The scene file.
        path: PathBuf,
    },
    /// The system refuses, or the disk is full.
    #[error(
        "{}: cannot be used: {source}; check the space and rights there. What was finished is kept: the same command goes on from it", path.display()
    )]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

impl WorkError {
    pub(crate) fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_path_buf(), source }
    }
}

/// Where a bake of `output` keeps what is finished, until all of it is.
pub fn working_folder(output: &Path) -> PathBuf {
    hidden_beside(output, ".bake")
}

/// Where the making of far fields for `output` keeps cells that are finished, until all are.
pub fn far_folder(output: &Path) -> PathBuf {
    hidden_beside(output, ".far")
}

/// The hidden name that belongs to `output` and ends in `ending`.
fn hidden_beside(output: &Path, ending: &str) -> PathBuf {
    let mut name = std::ffi::OsString::from(".");
    name.push(output.file_name().unwrap_or_default());
    name.push(ending);
    output.with_file_name(name)
}

/// Where the scene lies that far fields are added to before it becomes `output`: in [`far_folder`], which is made.
pub fn plain_scene(output: &Path) -> Result<PathBuf, WorkError> {
    let folder = far_folder(output);
    match std::fs::create_dir(&folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
            Err(WorkError::io(&folder, error))
        }
        _ => Ok(folder.join("plain.occ")),
    }
}

/// The folder, locked.
#[derive(Debug)]
pub(crate) struct Work {
    folder: PathBuf,
    /// Released when the process ends, however it ends.
    _lock: File,
}

impl Work {
    /// Makes and locks the folder for `output`.
    pub(crate) fn open(output: &Path) -> Result<Self, WorkError> {
        Self::open_at(working_folder(output), output)
    }

    /// The one for its far fields.
    pub(crate) fn open_far(output: &Path) -> Result<Self, WorkError> {
        Self::open_at(far_folder(output), output)
    }

    fn open_at(folder: PathBuf, output: &Path) -> Result<Self, WorkError> {
        // Only the last step of a bake would find out.
        if output.is_dir() {
            return Err(WorkError::io(output, io::ErrorKind::IsADirectory.into()));
        }
        let at = |source| WorkError::io(&folder, source);
        loop {
            match std::fs::create_dir(&folder) {
                Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
                    return Err(at(error));
                }
                _ => {}
            }
            let path = folder.join("lock");
            let lock = match File::create(&path) {
                // A bake that ended took its folder away between the two steps.
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                other => other.map_err(at)?,
            };
            match lock.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    return Err(WorkError::Busy { path: output.to_path_buf() });
                }
                Err(TryLockError::Error(source)) => return Err(at(source)),
            }
            // The same between opening and locking: then the lock is on a file that is gone.
            if path.exists() {
                return Ok(Self { folder, _lock: lock });
            }
        }
    }

    /// Removes what a bake left that was killed once its scene was in place, unless another is at work.
    pub(crate) fn sweep(output: &Path) {
        if working_folder(output).exists()
            && let Ok(work) = Self::open(output)
        {
            // The scene is there; a folder that cannot be removed is no harm to it.
            let _ = work.remove();
        }
    }

    /// A file in the folder.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// What the stage `name` left, if it was made from `key`.
    pub(crate) fn load(&self, name: &str, key: &Key) -> Option<Vec<u8>> {
        let bytes = std::fs::read(self.path(name)).ok()?;
        let (seal, payload) = bytes.split_at_checked(64)?;
        (seal[..32] == key[..] && seal[32..] == blake3::hash(payload).as_bytes()[..])
            .then(|| payload.to_vec())
    }

    /// Keeps what the stage `name` made from `key`; there at once or not at all.
    pub(crate) fn save(&self, name: &str, key: &Key, payload: &[u8]) -> Result<(), WorkError> {
        let temporary = self.path(&format!("{name}.new"));
        let write = || -> io::Result<()> {
            let mut file = File::create(&temporary)?;
            file.write_all(key)?;
            file.write_all(blake3::hash(payload).as_bytes())?;
            file.write_all(payload)?;
            std::fs::rename(&temporary, self.path(name))
        };
        write().map_err(|source| WorkError::io(&temporary, source))
    }

    /// Forgets a file that is not needed any more, if it is there.
    pub(crate) fn forget(&self, name: &str) {
        // What cannot be removed now goes with the folder.
        let _ = std::fs::remove_file(self.path(name));
    }

    /// Removes the folder, there being nothing to go on with.
    pub(crate) fn remove(self) -> Result<(), WorkError> {
        std::fs::remove_dir_all(&self.folder).map_err(|source| WorkError::io(&self.folder, source))
    }
}

/// Where a record lies in a file, and what it must hold.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct Span {
    pub(crate) offset: u64,
    pub(crate) bytes: u64,
    /// CRC-32C of its bytes.
    check: u64,
}

/// A file that records are appended to.
#[derive(Debug)]
pub(crate) struct Appender {
    path: PathBuf,
    file: io::BufWriter<File>,
    length: u64,
}

impl Appender {
    pub(crate) fn create(path: &Path) -> Result<Self, WorkError> {
        let file = File::create(path).map_err(|source| WorkError::io(path, source))?;
        Ok(Self { path: path.to_path_buf(), file: io::BufWriter::new(file), length: 0 })
    }

    /// Goes on behind the first `length` bytes; the rest is cut off.
    pub(crate) fn resume(path: &Path, length: u64) -> Result<Self, WorkError> {
        let open = || -> io::Result<File> {
            let mut file = File::options().write(true).create(true).truncate(false).open(path)?;
            file.set_len(length)?;
            file.seek(SeekFrom::Start(length))?;
            Ok(file)
        };
        let file = open().map_err(|source| WorkError::io(path, source))?;
        Ok(Self { path: path.to_path_buf(), file: io::BufWriter::new(file), length })
    }

    /// Appends one record made of several stretches of bytes.
    pub(crate) fn append(&mut self, stretches: &[&[u8]]) -> io::Result<Span> {
        let offset = self.length;
        let mut check = 0;
        for stretch in stretches {
            self.file.write_all(stretch)?;
            self.length += stretch.len() as u64;
            check = crc32c::crc32c_append(check, stretch);
        }
        Ok(Span { offset, bytes: self.length - offset, check: u64::from(check) })
    }

    /// [`Appender::append`], its fault with the file's name.
    pub(crate) fn add(&mut self, stretches: &[&[u8]]) -> Result<Span, WorkError> {
        self.append(stretches).map_err(|source| self.error(source))
    }

    /// A failed append, with the file's name.
    pub(crate) fn error(&self, source: io::Error) -> WorkError {
        WorkError::io(&self.path, source)
    }

    /// Hands everything to the system.
    pub(crate) fn flush(&mut self) -> Result<(), WorkError> {
        self.file.flush().map_err(|source| WorkError::io(&self.path, source))
    }
}

/// A file of records to be read in any order, by any thread.
#[derive(Debug)]
pub(crate) struct Records {
    path: PathBuf,
    file: Mutex<File>,
    length: u64,
}

impl Records {
    pub(crate) fn open(path: &Path) -> Result<Self, WorkError> {
        let at = |source| WorkError::io(path, source);
        let file = File::open(path).map_err(at)?;
        let length = file.metadata().map_err(at)?.len();
        Ok(Self { path: path.to_path_buf(), file: Mutex::new(file), length })
    }

    /// Reads one record into stretches that it fills.
    pub(crate) fn read_into(&self, span: Span, to: &mut [&mut [u8]]) -> Result<(), WorkError> {
        let bytes: usize = to.iter().map(|stretch| stretch.len()).sum();
        if bytes as u64 != span.bytes {
            return Err(self.torn());
        }
        let mut read = || {
            let mut file = self.file.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            file.seek(SeekFrom::Start(span.offset))?;
            to.iter_mut().try_for_each(|stretch| file.read_exact(stretch))
        };
        read().map_err(|source| match source.kind() {
            io::ErrorKind::UnexpectedEof => self.torn(),
            _ => WorkError::io(&self.path, source),
        })?;
        let check = to.iter().fold(0, |check, stretch| crc32c::crc32c_append(check, stretch));
        if u64::from(check) == span.check { Ok(()) } else { Err(self.torn()) }
    }

    /// Reads one record.
    pub(crate) fn read(&self, span: Span) -> Result<Vec<u8>, WorkError> {
        if span.offset.checked_add(span.bytes).is_none_or(|end| end > self.length) {
            return Err(self.torn());
        }
        let mut bytes = vec![0; span.bytes as usize];
        self.read_into(span, &mut [&mut bytes])?;
        Ok(bytes)
    }

    /// Whether all these records are there as they were written.
    pub(crate) fn holds(&self, spans: impl Iterator<Item = Span>) -> bool {
        let mut bytes = vec![0; 1 << 16];
        spans.into_iter().all(|span| self.is_sound(span, &mut bytes))
    }

    fn is_sound(&self, span: Span, buffer: &mut [u8]) -> bool {
        let mut file = self.file.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let (mut left, mut check) = (span.bytes, 0);
        if file.seek(SeekFrom::Start(span.offset)).is_err() {
            return false;
        }
        while left > 0 {
            let few = &mut buffer[..left.min(1 << 16) as usize];
            if file.read_exact(few).is_err() {
                return false;
            }
            check = crc32c::crc32c_append(check, few);
            left -= few.len() as u64;
        }
        u64::from(check) == span.check
    }

    /// The error of a record that is not what it should be.
    pub(crate) fn torn(&self) -> WorkError {
        WorkError::io(&self.path, crate::bytes::Torn.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_is_found_again_by_its_key_alone() {
        let folder = tempfile::tempdir().unwrap();
        let work = Work::open(&folder.path().join("a.occ")).unwrap();
        assert_eq!(work.load("plan", &[1; 32]), None);
        work.save("plan", &[1; 32], b"all of it").unwrap();
        assert_eq!(work.load("plan", &[1; 32]).as_deref(), Some(&b"all of it"[..]));
        assert_eq!(work.load("plan", &[2; 32]), None);
        let path = work.path("plan");
        let whole = std::fs::read(&path).unwrap();
        for end in 0..whole.len() {
            std::fs::write(&path, &whole[..end]).unwrap();
            assert_eq!(work.load("plan", &[1; 32]), None, "cut to {end}");
        }
    }

    #[test]
    fn one_bake_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("a.occ");
        let first = Work::open(&output).unwrap();
        assert!(matches!(Work::open(&output), Err(WorkError::Busy { .. })));
        assert!(Work::open(&folder.path().join("b.occ")).is_ok());
        first.remove().unwrap();
        let again = Work::open(&output).unwrap();
        drop(again);
        assert!(Work::open(&output).is_ok());
    }

    #[test]
    fn records_come_back_and_the_end_of_the_file_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("records");
        let mut out = Appender::create(&path).unwrap();
        let first = out.append(&[b"one", b"two"]).unwrap();
        let second = out.append(&[b"three"]).unwrap();
        out.flush().unwrap();
        let records = Records::open(&path).unwrap();
        assert_eq!(records.read(second).unwrap(), b"three");
        assert_eq!(records.read(first).unwrap(), b"onetwo");
        assert!(records.holds([first, second].into_iter()));
        for wrong in [
            Span { offset: 7, ..second },
            Span { offset: u64::MAX, ..second },
            Span { bytes: 4, ..second },
            Span { bytes: u64::MAX, ..second },
            Span { check: 0, ..second },
        ] {
            assert!(records.read(wrong).is_err() && !records.holds([wrong].into_iter()));
        }
        std::fs::write(&path, b"onetwothref").unwrap();
        let says = records.read(second).unwrap_err().to_string();
        assert!(says.contains("records") && says.contains("torn"), "{says}");
        assert!(records.holds([first].into_iter()) && !records.holds([second].into_iter()));
        let mut out = Appender::resume(&path, 3).unwrap();
        out.append(&[b"!"]).unwrap();
        out.flush().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"one!");
    }
}
