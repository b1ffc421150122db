//! A file whose bytes are copied out and never borrowed: whatever others do to it while it is open is
//! an error here, and no signal.
//!
//! On Linux the file is mapped, and the kernel copies out of the map (`process_vm_readv` on this very
//! process). Where it cannot have a page it says so; a load from that page would raise SIGBUS.
//! Elsewhere, and where a sandbox forbids the call, positioned reads do the same.

use std::fs::File;
use std::io::{self, Read};

#[cfg(target_os = "linux")]
use {
    memmap2::{MmapOptions, MmapRaw, UncheckedAdvice},
    std::sync::atomic::{AtomicUsize, Ordering},
};

/// What the kernel is thought to map around a page that is touched: it maps whole pieces of its cache.
#[cfg(target_os = "linux")]
const MAPPED_AROUND: usize = 512 << 10;

/// About the most bytes of the map that copies leave resident.
#[cfg(target_os = "linux")]
const MOST_RESIDENT: usize = 4 << 20;

/// An open file of a length that was checked.
#[derive(Debug)]
pub(super) struct Guarded {
    file: File,
    bytes: u64,
    #[cfg(target_os = "linux")]
    map: MmapRaw,
    /// How much of the map may be resident.
    #[cfg(target_os = "linux")]
    resident: AtomicUsize,
}

impl Guarded {
    /// Takes the first `bytes` of a file, of which there is at least one.
    pub(super) fn new(file: File, bytes: u64) -> io::Result<Self> {
        Ok(Self {
            #[cfg(target_os = "linux")]
            map: {
                let whole = usize::try_from(bytes).map_err(|_| io::ErrorKind::OutOfMemory)?;
                MmapOptions::new().len(whole).map_raw_read_only(&file)?
            },
            #[cfg(target_os = "linux")]
            resident: AtomicUsize::new(0),
            file,
            bytes,
        })
    }

    /// Bytes it had when it was opened.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Whether it has become shorter than `end`.
    pub(super) fn ends_before(&self, end: u64) -> bool {
        self.file.metadata().is_ok_and(|now| now.len() < end)
    }

    /// Fills `out` with the bytes from `at` on.
    ///
    /// The rest of the page in which a shortened file ends reads as zeros, as in any map.
    ///
    /// # Errors
    /// [`io::ErrorKind::UnexpectedEof`] where the file has become too short; the system's own.
    ///
    /// # Panics
    /// If the file was shorter when it was opened.
    pub(super) fn copy(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        let end = at.checked_add(out.len() as u64);
        assert!(end.is_some_and(|end| end <= self.bytes), "{at} and {} bytes", out.len());
        // What the map does not yield is asked of the file, which has it or can say why not.
        let done = self.copy_mapped(at, out);
        read_exact_at(&self.file, &mut out[done..], at + done as u64)
    }

    /// All bytes, from the first on.
    pub(super) fn reader(&self) -> impl Read + '_ {
        Reader { guarded: self, at: 0 }
    }

    /// Copies out of the map; returns how many bytes came, from the first on.
    #[cfg(target_os = "linux")]
    fn copy_mapped(&self, at: u64, out: &mut [u8]) -> usize {
        use nix::sys::uio::{RemoteIoVec, process_vm_readv};
        let (at, this) = (at as usize, nix::unistd::Pid::this());
        let mut done = 0;
        while done < out.len() {
            let base = self.map.as_ptr() as usize + at + done;
            let from = RemoteIoVec { base, len: out.len() - done };
            let to = io::IoSliceMut::new(&mut out[done..]);
            match process_vm_readv(this, &mut [to], &[from]) {
                Ok(0) | Err(_) => break,
                Ok(count) => done += count,
            }
        }
        self.forget(out.len());
        done
    }

    #[cfg(not(target_os = "linux"))]
    fn copy_mapped(&self, _at: u64, _out: &mut [u8]) -> usize {
        0
    }

    /// Notes what a copy made resident, and takes the whole map out of this process again before that is
    /// much; the system keeps the pages cached.
    ///
    /// Not at once: what is mapped around one copy mostly serves the next, and mapping is what costs.
    #[cfg(target_os = "linux")]
    #[allow(unsafe_code, reason = "memmap2 cannot know that nothing borrows from the map")]
    fn forget(&self, len: usize) {
        let more = len + MAPPED_AROUND;
        if self.resident.fetch_add(more, Ordering::Relaxed) + more < MOST_RESIDENT {
            return;
        }
        self.resident.store(0, Ordering::Relaxed);
        // SAFETY: The map shows a file, so a page that is dropped comes back with the file's contents;
        // and no reference into the map exists, here or in another thread, that could see it change: all
        // access is the kernel's.
        let advice = unsafe {
            self.map.unchecked_advise_range(UncheckedAdvice::DontNeed, 0, self.map.len())
        };
        // Locked pages stay (EINVAL): resident is what whoever locked them wanted.
        drop(advice);
    }
}

/// Reads a [`Guarded`] from front to back.
struct Reader<'a> {
    guarded: &'a Guarded,
    at: u64,
}

impl Read for Reader<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let left = self.guarded.bytes - self.at;
        let count = out.len().min(usize::try_from(left).unwrap_or(usize::MAX));
        self.guarded.copy(self.at, &mut out[..count])?;
        self.at += count as u64;
        Ok(count)
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, out: &mut [u8], at: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, out, at)
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut out: &mut [u8], mut at: u64) -> io::Result<()> {
    while !out.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, out, at) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => (out, at) = (&mut out[count..], at + count as u64),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => (),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use super::*;
    use std::fs::OpenOptions;

    /// The map of an empty file: what a sandbox that forbids the call makes of any.
    fn without_map(file: File, bytes: u64) -> Guarded {
        let empty = tempfile::tempfile().unwrap();
        let map = MmapOptions::new().len(bytes as usize).map_raw_read_only(&empty).unwrap();
        Guarded { file, bytes, map, resident: AtomicUsize::new(0) }
    }

    #[test]
    fn what_the_map_does_not_yield_is_read_from_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let bytes: Vec<u8> = (0..10_000).map(|i| (i * i % 251) as u8).collect();
        std::fs::write(&path, &bytes).unwrap();
        let guarded = without_map(File::open(&path).unwrap(), 10_000);
        for range in [0..10_000, 4095..4097, 9_999..10_000, 5..5] {
            let mut out = vec![0; range.len()];
            guarded.copy(range.start as u64, &mut out).unwrap();
            assert_eq!(out, bytes[range]);
        }
        let mut all = Vec::new();
        guarded.reader().read_to_end(&mut all).unwrap();
        assert_eq!(all, bytes);

        let closed = OpenOptions::new().write(true).open(&path).unwrap();
        let error = without_map(closed, 10_000).copy(0, &mut [0; 9]).unwrap_err();
        assert_ne!(error.kind(), io::ErrorKind::UnexpectedEof);
        OpenOptions::new().write(true).open(&path).unwrap().set_len(5_000).unwrap();
        let error = guarded.copy(4_999, &mut [0; 2]).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
        assert!(guarded.ends_before(5_001) && !guarded.ends_before(5_000));
    }

    #[test]
    fn the_map_alone_yields_everything_at_any_offset() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let bytes: Vec<u8> = (0..300_000u64).map(|i| (i * i % 251) as u8).collect();
        std::fs::write(&path, &bytes).unwrap();
        let guarded = Guarded::new(File::open(&path).unwrap(), 300_000).unwrap();
        let mut out = vec![0; bytes.len()];
        if guarded.copy_mapped(0, &mut out) == 0 {
            eprintln!("skipped: this system forbids the call");
            return;
        }
        for range in [0..300_000, 4095..8193, 65_535..200_001, 299_999..300_000] {
            let out = &mut out[..range.len()];
            assert_eq!(guarded.copy_mapped(range.start as u64, out), range.len());
            assert_eq!(out, &bytes[range]);
        }
    }

    #[test]
    #[should_panic(expected = "9999 and 2 bytes")]
    fn a_place_behind_the_end_is_our_own_mistake() {
        without_map(tempfile::tempfile().unwrap(), 10_000).copy(9_999, &mut [0; 2]).unwrap();
    }
}
