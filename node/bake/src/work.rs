//! The working folder of a bake: `.NAME.bake` beside the output NAME.
//!
//! It holds what every finished stage made, under the digest of what that stage was made from, so that
//! a bake that was cut short goes on where it was. A finished bake removes it. One bake at a time works
//! in it.

use std::fs::{File, TryLockError};
use std::io::{self, Seek, SeekFrom, Write};
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
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    output.with_file_name(format!(".{name}.bake"))
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
        // Only the last step of a bake would find out.
        if output.is_dir() {
            return Err(WorkError::io(output, io::ErrorKind::IsADirectory.into()));
        }
        let folder = working_folder(output);
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

/// Where a record lies in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct Span {
    pub(crate) offset: u64,
    pub(crate) bytes: u64,
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
        for stretch in stretches {
            self.file.write_all(stretch)?;
            self.length += stretch.len() as u64;
        }
        Ok(Span { offset, bytes: self.length - offset })
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

    /// Reads bytes that were appended at `offset` into `to`.
    pub(crate) fn read_into(&self, offset: u64, to: &mut [u8]) -> Result<(), WorkError> {
        let mut read = || {
            use std::io::Read;
            let mut file = self.file.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            file.seek(SeekFrom::Start(offset))?;
            file.read_exact(to)
        };
        read().map_err(|source| WorkError::io(&self.path, source))
    }

    /// Reads one record.
    pub(crate) fn read(&self, span: Span) -> Result<Vec<u8>, WorkError> {
        if span.offset.checked_add(span.bytes).is_none_or(|end| end > self.length) {
            return Err(self.torn());
        }
        let mut bytes = vec![0; span.bytes as usize];
        self.read_into(span.offset, &mut bytes)?;
        Ok(bytes)
    }

    /// The error of a record that is not what it should be.
    pub(crate) fn torn(&self) -> WorkError {
        WorkError::io(&self.path, crate::bytes::Torn.into())
    }

    /// Bytes in the file when it was opened.
    pub(crate) fn length(&self) -> u64 {
        self.length
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
        assert!(records.read(Span { offset: 6, bytes: 6 }).is_err());
        assert!(records.read(Span { offset: u64::MAX, bytes: 6 }).is_err());
        let mut out = Appender::resume(&path, 3).unwrap();
        out.append(&[b"!"]).unwrap();
        out.flush().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"one!");
    }
}
