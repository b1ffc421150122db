//! Writes pictures to files on a thread of its own, so that a phase does not wait for compression.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError};
use protocol::id::FrameIndex;
use protocol::settings::PictureSize;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

/// Pictures that may wait for the disk; the next one waits with the renderer.
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
    /// The writer ended before its time.
    #[error("the picture writer ended before its time")]
    Gone,
}

struct Order {
    frame: FrameIndex,
    rgba: Vec<u8>,
}

/// The writer: pictures in, files out, in order. Dropped, it ends the file it is at and forgets what is queued, so
/// that a process which leaves early leaves no half-written file.
pub struct PictureWriter {
    size: PictureSize,
    abandoned: Arc<AtomicBool>,
    orders: Option<crossbeam_channel::Sender<Order>>,
    thread: Option<JoinHandle<Result<(), PictureError>>>,
}

impl PictureWriter {
    /// Makes `folder` and starts the thread.
    pub fn start(folder: PathBuf, size: PictureSize) -> Result<Self, PictureError> {
        std::fs::create_dir_all(&folder)
            .map_err(|source| PictureError::Write { path: folder.clone(), source })?;
        let (orders, inbox) = crossbeam_channel::bounded::<Order>(QUEUED);
        let abandoned = Arc::new(AtomicBool::new(false));
        let is_abandoned = Arc::clone(&abandoned);
        let thread = std::thread::spawn(move || {
            let mut wanted = inbox.iter().take_while(|_| !is_abandoned.load(Ordering::Relaxed));
            wanted.try_for_each(|order| write_png(&folder, &order, size))
        });
        Ok(Self { size, abandoned, orders: Some(orders), thread: Some(thread) })
    }

    /// Queues the picture of `frame`: `4 * width * height` bytes. Waits while the queue is full; an
    /// error is that of an earlier picture.
    pub fn write(&mut self, frame: FrameIndex, rgba: Vec<u8>) -> Result<(), PictureError> {
        let bytes = 4 * self.size.width as usize * self.size.height as usize;
        assert_eq!(rgba.len(), bytes, "bytes of a picture");
        let order = Order { frame, rgba };
        match self.orders.as_ref().map(|orders| orders.send(order)) {
            Some(Ok(())) => Ok(()),
            // The thread ends early only on an error, which finish reports.
            _ => self.finish().and(Err(PictureError::Gone)),
        }
    }

    /// Waits until all queued pictures are files.
    pub fn finish(&mut self) -> Result<(), PictureError> {
        self.orders = None;
        match self.thread.take().map(JoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(_)) => Err(PictureError::Gone),
        }
    }
}

impl Drop for PictureWriter {
    fn drop(&mut self) {
        self.abandoned.store(true, Ordering::Relaxed);
        if let Err(error) = self.finish() {
            tracing::warn!("{error}");
        }
    }
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

    #[test]
    fn no_pictures_leave_an_empty_folder() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("a/b");
        PictureWriter::start(inner.clone(), SIZE).unwrap().finish().unwrap();
        assert!(names(&inner).is_empty());
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, b"x").unwrap();
        let error = PictureWriter::start(file.join("sub"), SIZE).err().unwrap();
        assert!(error.to_string().contains("file/sub"), "{error}");
    }

    #[test]
    #[should_panic(expected = "bytes of a picture")]
    fn a_picture_of_another_size_is_our_mistake() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = PictureWriter::start(folder.path().into(), SIZE).unwrap();
        let _ = writer.write(FrameIndex(0), vec![0; 5]);
    }

    #[test]
    fn pictures_come_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = PictureWriter::start(folder.path().into(), SIZE).unwrap();
        let rgba: Vec<u8> = (0..24).collect();
        for frame in 0..9 {
            writer.write(FrameIndex(frame), rgba.clone()).unwrap();
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
        let mut writer = PictureWriter::start(folder.path().into(), size).unwrap();
        for frame in 0..3 {
            let noise = |at: u32| at.wrapping_mul(2_654_435_761).to_be_bytes();
            writer.write(FrameIndex(frame), (0..700_000).flat_map(noise).collect()).unwrap();
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
    fn a_vanished_folder_is_reported_by_a_later_call() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("gone");
        let mut writer = PictureWriter::start(inner.clone(), SIZE).unwrap();
        std::fs::remove_dir(&inner).unwrap();
        let results: Vec<_> =
            (0..20).map(|frame| writer.write(FrameIndex(frame), vec![0; 24])).collect();
        let failed = results.into_iter().find_map(Result::err).or(writer.finish().err());
        assert!(failed.unwrap().to_string().contains("000000.png"));
    }
}
