//! Files of the working folder that hold what does not fit the memory: records of one kind, written
//! once, read front to back, and gone when they are not needed any more.

use crate::work::{Work, WorkError};
use bytemuck::Pod;
use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::marker::PhantomData;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes that are read or written at once.
const BLOCK: usize = 1 << 16;

/// A file that is being written.
#[derive(Debug)]
pub(crate) struct ScratchWriter<T> {
    file: BufWriter<File>,
    written: Scratch<T>,
}

/// A file that was written.
#[derive(Debug)]
pub(crate) struct Scratch<T> {
    path: PathBuf,
    count: u64,
    kind: PhantomData<T>,
}

impl<T: Pod> ScratchWriter<T> {
    /// An empty file; `name` says what for.
    pub(crate) fn create(work: &Work, name: &str) -> Result<Self, WorkError> {
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        let path = work.path(&format!("{name}.{}", NUMBER.fetch_add(1, Ordering::Relaxed)));
        let file = File::create(&path).map_err(|source| WorkError::io(&path, source))?;
        let written = Scratch { path, count: 0, kind: PhantomData };
        Ok(Self { file: BufWriter::with_capacity(BLOCK, file), written })
    }

    /// Appends records.
    pub(crate) fn push(&mut self, records: &[T]) -> Result<(), WorkError> {
        self.written.count += records.len() as u64;
        let written = self.file.write_all(bytemuck::cast_slice(records));
        written.map_err(|source| WorkError::io(&self.written.path, source))
    }

    /// Ends it.
    pub(crate) fn finish(mut self) -> Result<Scratch<T>, WorkError> {
        let flushed = self.file.flush();
        flushed.map_err(|source| WorkError::io(&self.written.path, source))?;
        Ok(self.written)
    }
}

impl<T: Pod> Scratch<T> {
    /// Opens it for a walk from the front.
    pub(crate) fn read(&self) -> Result<Walk<'_, T>, WorkError> {
        let file = File::open(&self.path).map_err(|source| WorkError::io(&self.path, source))?;
        Ok(Walk { scratch: self, file, left: self.count })
    }

    /// Hears of all records, some at a time.
    pub(crate) fn for_each(
        &self,
        mut each: impl FnMut(&[T]) -> Result<(), WorkError>,
    ) -> Result<(), WorkError> {
        let mut walk = self.read()?;
        while walk.left > 0 {
            each(&walk.next(BLOCK / size_of::<T>())?)?;
        }
        Ok(())
    }

    /// All records.
    pub(crate) fn load(&self) -> Result<Vec<T>, WorkError> {
        self.read()?.next(usize::MAX)
    }
}

impl<T> Drop for Scratch<T> {
    fn drop(&mut self) {
        // What cannot be removed now goes with the folder.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Reads records from the front.
#[derive(Debug)]
pub(crate) struct Walk<'a, T> {
    scratch: &'a Scratch<T>,
    file: File,
    left: u64,
}

impl<T: Pod> Walk<'_, T> {
    /// The next `most` records, fewer at the end.
    pub(crate) fn next(&mut self, most: usize) -> Result<Vec<T>, WorkError> {
        let count = self.left.min(most as u64);
        let mut records = vec![T::zeroed(); count as usize];
        let read = self.file.read_exact(bytemuck::cast_slice_mut(&mut records));
        read.map_err(|source: io::Error| WorkError::io(&self.scratch.path, source))?;
        self.left -= count;
        Ok(records)
    }
}

/// Most files of one set that are open at once.
const MOST_BUCKETS: u64 = 256;

/// Records sorted roughly, a file for each share.
#[derive(Debug)]
pub(crate) struct Buckets<T>(Vec<ScratchWriter<T>>);

impl<T: Pod> Buckets<T> {
    /// So many buckets, within reason.
    pub(crate) fn create(work: &Work, name: &str, count: u64) -> Result<Self, WorkError> {
        let create = |_| ScratchWriter::create(work, name);
        (0..count.clamp(1, MOST_BUCKETS)).map(create).collect::<Result<_, _>>().map(Self)
    }

    /// How many there are.
    pub(crate) fn count(&self) -> u64 {
        self.0.len() as u64
    }

    /// Appends a record to bucket `share`.
    pub(crate) fn push(&mut self, share: u64, record: T) -> Result<(), WorkError> {
        self.0[share as usize].push(&[record])
    }

    /// All buckets, in order.
    pub(crate) fn finish(self) -> Result<Vec<Scratch<T>>, WorkError> {
        self.0.into_iter().map(ScratchWriter::finish).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_come_back_and_the_files_go() {
        let folder = tempfile::tempdir().unwrap();
        let work = Work::open(&folder.path().join("a.occ")).unwrap();
        let files = || std::fs::read_dir(work.path("")).unwrap().count();
        let before = files();
        let mut buckets = Buckets::create(&work, "some", 3).unwrap();
        assert_eq!((buckets.count(), files()), (3, before + 3));
        let many = 100_000u64;
        (0..many).for_each(|i| buckets.push(i % 2, [i, i + 1]).unwrap());
        let buckets = buckets.finish().unwrap();
        for (share, bucket) in (0..).zip(&buckets) {
            let expected: Vec<[u64; 2]> =
                (0..many).filter(|i| i % 2 == share).map(|i| [i, i + 1]).collect();
            assert_eq!(bucket.load().unwrap(), expected);
            let mut walked = Vec::new();
            let walk = |some: &[[u64; 2]]| {
                walked.extend_from_slice(some);
                Ok(())
            };
            bucket.for_each(walk).unwrap();
            assert_eq!(walked, expected);
            let mut walk = bucket.read().unwrap();
            assert!(walk.next(7).unwrap() == expected[..expected.len().min(7)]);
            assert!(walk.next(usize::MAX).unwrap() == expected[expected.len().min(7)..]);
        }
        drop(buckets);
        assert_eq!(files(), before);
    }
}
