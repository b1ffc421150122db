//! Hashes pictures, and writes them to files where that is asked for, on a thread of its own: no phase
//! waits for either.

use crate::role::picture_hash;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError};
use protocol::id::FrameIndex;
use protocol::settings::PictureSize;
use protocol::telemetry::Nanos;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Instant;

/// Pictures that may wait for the thread; the next one waits with the renderer.
const QUEUED: usize = 4;

/// Why a picture was not written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The folder or file refuses.
    #[error("cannot write the picture {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The encoder refuses.
    #[error("cannot encode the picture {}: {reason}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// What the encoder says.
        reason: String,
    },
    /// The thread broke down.
    #[error("the picture thread broke down; see its message above")]
    Gone,
}

/// A picture's hash is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hashed {
    /// The frame.
    pub frame: FrameIndex,
    /// First 8 bytes of the BLAKE3 of its RGBA bytes, little-endian.
    pub hash: u64,
    /// How long that took.
    pub hashing: Nanos,
}

struct Order {
    frame: FrameIndex,
    rgba: Vec<u8>,
}

/// The thread: pictures in, hashes and files out, in order. Dropped, it ends the file it is at and forgets what
/// is queued, so that a process which leaves early leaves no half-written file.
pub struct PictureThread {
    size: PictureSize,
    abandoned: Arc<AtomicBool>,
    orders: Option<crossbeam_channel::Sender<Order>>,
    thread: Option<JoinHandle<Result<(), PictureError>>>,
}

impl PictureThread {
    /// Makes `folder`, if there is one to write to, and starts the thread. `tell` hears of every hash as
    /// soon as it is known, before the file is written, and of the error that ends the thread.
    pub fn start(
        folder: Option<PathBuf>,
        size: PictureSize,
        tell: impl Fn(Result<Hashed, &PictureError>) + Send + 'static,
    ) -> Result<Self, PictureError> {
        if let Some(folder) = &folder {
            std::fs::create_dir_all(folder)
                .map_err(|source| PictureError::Write { path: folder.clone(), source })?;
        }
        let (orders, inbox) = crossbeam_channel::bounded::<Order>(QUEUED);
        let abandoned = Arc::new(AtomicBool::new(false));
        let is_abandoned = Arc::clone(&abandoned);
        let thread = std::thread::spawn(move || {
            let mut wanted = inbox.iter().take_while(|_| !is_abandoned.load(Ordering::Relaxed));
            let work = || {
                wanted.try_for_each(|order| {
                    tell(Ok(hash(&order)));
                    folder.as_ref().map_or(Ok(()), |folder| write_png(folder, &order, size))
                })
            };
            let worked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
            let result = worked.unwrap_or(Err(PictureError::Gone));
            // Nobody hands over another picture, perhaps: this one's failure must not wait for that.
            result.inspect_err(|error| tell(Err(error)))
        });
        Ok(Self { size, abandoned, orders: Some(orders), thread: Some(thread) })
    }

    /// Queues the picture of `frame`: `4 * width * height` bytes. Waits while the queue is full; an
    /// error is that of an earlier picture.
    pub fn hand_over(&mut self, frame: FrameIndex, rgba: Vec<u8>) -> Result<(), PictureError> {
        let bytes = 4 * self.size.width as usize * self.size.height as usize;
        assert_eq!(rgba.len(), bytes, "bytes of a picture");
        let order = Order { frame, rgba };
        match self.orders.as_ref().map(|orders| orders.send(order)) {
            Some(Ok(())) => Ok(()),
            // The thread ends early only on an error, which finish reports.
            _ => self.finish().and(Err(PictureError::Gone)),
        }
    }

    /// Waits until all queued pictures are hashed, and files.
    pub fn finish(&mut self) -> Result<(), PictureError> {
        self.orders = None;
        match self.thread.take().map(JoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(_)) => Err(PictureError::Gone),
        }
    }
}

impl Drop for PictureThread {
    fn drop(&mut self) {
        self.abandoned.store(true, Ordering::Relaxed);
        if let Err(error) = self.finish() {
            tracing::warn!("{error}");
        }
    }
}

fn hash(order: &Order) -> Hashed {
    let started = Instant::now();
    let hash = picture_hash(&order.rgba);
    // 64 bits of nanoseconds last 584 years.
    Hashed { frame: order.frame, hash, hashing: started.elapsed().as_nanos() as Nanos }
}

/// `folder/000000.png`, complete or not there at all.
fn write_png(folder: &Path, order: &Order, size: PictureSize) -> Result<(), PictureError> {
    let path = folder.join(format!("{:06}.png", order.frame.0));
    let partial = folder.join(format!(".{:06}.png.{}.tmp", order.frame.0, std::process::id()));
    let written = encode(&partial, &order.rgba, size)
        .and_then(|()| std::fs::rename(&partial, &path).map_err(ImageError::IoError));
    written.map_err(|error| {
        // Best effort: the error that led here matters more than the one of cleaning up.
        let _ = std::fs::remove_file(&partial);
        match error {
            ImageError::IoError(source) => PictureError::Write { path, source },
            other => PictureError::Encode { path, reason: other.to_string() },
        }
    })
}

fn encode(path: &Path, rgba: &[u8], size: PictureSize) -> Result<(), ImageError> {
    let mut file = BufWriter::new(File::create(path)?);
    PngEncoder::new_with_quality(&mut file, CompressionType::Fast, FilterType::Up).write_image(
        rgba,
        size.width,
        size.height,
        ExtendedColorType::Rgba8,
    )?;
    file.flush()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: PictureSize = PictureSize { width: 3, height: 2 };

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<_> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn start(folder: &Path, size: PictureSize) -> PictureThread {
        PictureThread::start(Some(folder.into()), size, |_| ()).unwrap()
    }

    #[test]
    fn hashes_are_told_in_order_with_and_without_files() {
        let folder = tempfile::tempdir().unwrap();
        for at in [None, Some(folder.path().to_owned())] {
            let (tell, told) = crossbeam_channel::unbounded();
            let tell = move |news: Result<Hashed, &PictureError>| tell.send(news.unwrap()).unwrap();
            let mut thread = PictureThread::start(at, SIZE, tell).unwrap();
            for frame in 0..9 {
                thread.hand_over(FrameIndex(frame), vec![frame as u8; 24]).unwrap();
            }
            thread.finish().unwrap();
            let told: Vec<_> = told.try_iter().map(|news| (news.frame.0, news.hash)).collect();
            let expected = (0..9).map(|frame| (frame, picture_hash(&[frame as u8; 24])));
            assert_eq!(told, expected.collect::<Vec<_>>());
        }
    }

    #[test]
    fn no_pictures_leave_an_empty_folder() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("a/b");
        start(&inner, SIZE).finish().unwrap();
        assert!(names(&inner).is_empty());
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, b"x").unwrap();
        let error = PictureThread::start(Some(file.join("sub")), SIZE, |_| ()).err().unwrap();
        assert!(error.to_string().contains("file/sub"), "{error}");
    }

    #[test]
    #[should_panic(expected = "bytes of a picture")]
    fn a_picture_of_another_size_is_our_mistake() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = start(folder.path(), SIZE);
        let _ = writer.hand_over(FrameIndex(0), vec![0; 5]);
    }

    #[test]
    fn pictures_come_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = start(folder.path(), SIZE);
        let rgba: Vec<u8> = (0..24).collect();
        for frame in 0..9 {
            writer.hand_over(FrameIndex(frame), rgba.clone()).unwrap();
        }
        writer.finish().unwrap();
        assert_eq!(names(folder.path()).len(), 9);
        let image = image::open(folder.path().join("000008.png")).unwrap();
        assert_eq!(image.to_rgba8().into_raw(), rgba);
    }

    #[test]
    fn a_writer_that_is_dropped_ends_the_file_it_is_at_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let size = PictureSize { width: 1000, height: 700 };
        let mut writer = start(folder.path(), size);
        for frame in 0..3 {
            let noise = |at: u32| at.wrapping_mul(2_654_435_761).to_be_bytes();
            writer.hand_over(FrameIndex(frame), (0..700_000).flat_map(noise).collect()).unwrap();
        }
        while names(folder.path()).is_empty() {
            std::thread::yield_now();
        }
        drop(writer);
        let names = names(folder.path());
        assert!(names == ["000000.png"] || names == ["000000.png", "000001.png"], "{names:?}");
        assert!(image::open(folder.path().join(names.last().unwrap())).is_ok());
    }

    #[test]
    fn a_vanished_folder_is_reported_at_once_and_by_a_later_call() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("gone");
        let (tell, told) = crossbeam_channel::unbounded();
        let tell = move |news: Result<Hashed, &PictureError>| {
            tell.send(news.map_err(ToString::to_string)).unwrap();
        };
        let mut writer = PictureThread::start(Some(inner.clone()), SIZE, tell).unwrap();
        std::fs::remove_dir(&inner).unwrap();
        let results: Vec<_> =
            (0..20).map(|frame| writer.hand_over(FrameIndex(frame), vec![0; 24])).collect();
        let failed = results.into_iter().find_map(Result::err).or(writer.finish().err());
        assert!(failed.unwrap().to_string().contains("000000.png"));
        let told: Vec<_> = told.try_iter().collect();
        assert!(told[0].is_ok() && told[1].as_ref().is_err_and(|e| e.contains("000000.png")));
    }
}
