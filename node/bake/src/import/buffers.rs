//! The bytes behind a document: its buffers and the views into them.

use std::borrow::Cow;
use std::path::Path;

use super::document::{Document, label};
use super::error::ImportError;
use super::uri::Folder;

/// A parsed document with every buffer loaded, and the file's name for messages.
pub(super) struct Resources<'a> {
    pub(super) file: &'a Path,
    pub(super) document: &'a Document,
    buffers: Vec<Cow<'a, [u8]>>,
}

impl<'a> Resources<'a> {
    /// Loads every buffer. `bin` is the binary chunk of a GLB, which stands for a first buffer
    /// without a URI (glTF 2.0, section 4.4.3.1).
    pub(super) fn load(
        file: &'a Path,
        document: &'a Document,
        bin: Option<&'a [u8]>,
    ) -> Result<Self, ImportError> {
        let mut resources =
            Self { file, document, buffers: Vec::with_capacity(document.buffers.len()) };
        for (number, buffer) in document.buffers.iter().enumerate() {
            let at = format!("buffer {number}");
            let mut bytes: Cow<'a, [u8]> = match (&buffer.uri, bin) {
                (Some(uri), _) => Cow::Owned(Folder { file }.read(&at, uri)?),
                (None, Some(chunk)) if number == 0 => Cow::Borrowed(chunk),
                (None, _) => {
                    let what = "it has neither a URI nor the file's binary chunk".into();
                    return Err(resources.invalid(
                        at,
                        what,
                        "export the file again, with its buffers",
                    ));
                }
            };
            if bytes.len() < buffer.byte_length {
                let what =
                    format!("it claims {} bytes and has {}", buffer.byte_length, bytes.len());
                return Err(resources.invalid(at, what, "export or copy the file again"));
            }
            match &mut bytes {
                Cow::Borrowed(slice) => *slice = &slice[..buffer.byte_length],
                Cow::Owned(vec) => vec.truncate(buffer.byte_length),
            }
            resources.buffers.push(bytes);
        }
        Ok(resources)
    }

    /// Bytes in all buffers together: no honest count of anything exceeds it.
    pub(super) fn total_bytes(&self) -> usize {
        self.buffers.iter().map(|buffer| buffer.len()).sum()
    }

    /// The bytes of a buffer view and its stride, if it names one; `at` names who asks.
    pub(super) fn view(
        &self,
        at: &str,
        number: usize,
    ) -> Result<(&[u8], Option<usize>), ImportError> {
        let view = self.document.buffer_views.get(number).ok_or_else(|| {
            self.broken(
                at,
                format!(
                    "it refers to buffer view {number} of {}",
                    self.document.buffer_views.len()
                ),
            )
        })?;
        let buffer = self.buffers.get(view.buffer).ok_or_else(|| {
            self.broken(
                at,
                format!(
                    "its buffer view {number} refers to buffer {} of {}",
                    view.buffer,
                    self.buffers.len()
                ),
            )
        })?;
        let bytes = range(buffer, view.byte_offset, view.byte_length).ok_or_else(|| {
            let (start, length, has) = (view.byte_offset, view.byte_length, buffer.len());
            self.broken(
                at,
                format!(
                    "its buffer view {number} takes {length} bytes at {start} of a buffer of {has}"
                ),
            )
        })?;
        // Some exporters write 0 where they mean "tightly packed".
        Ok((bytes, view.byte_stride.filter(|&stride| stride != 0)))
    }

    /// The bytes of an image, embedded or in a file of its own, and what to call it.
    pub(super) fn image(&self, number: usize) -> Result<(Cow<'_, [u8]>, String), ImportError> {
        let at = self.image_label(number);
        let Some(image) = self.document.images.get(number) else {
            return Err(
                self.broken(&at, format!("the file has {} images", self.document.images.len()))
            );
        };
        let bytes = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => Cow::Owned(Folder { file: self.file }.read(&at, uri)?),
            (None, Some(view)) => Cow::Borrowed(self.view(&at, view)?.0),
            (None, None) => {
                return Err(self.broken(&at, "it has neither a URI nor a buffer view".into()));
            }
        };
        Ok((bytes, at))
    }

    fn image_label(&self, number: usize) -> String {
        label(
            "image",
            number,
            self.document.images.get(number).and_then(|image| image.name.as_ref()),
        )
    }

    /// An object that contradicts the bytes it stands on; only a new export can mend it.
    pub(super) fn broken(&self, at: &str, what: String) -> ImportError {
        self.invalid(at.into(), what, "export the file again")
    }

    pub(super) fn invalid(&self, at: String, what: String, fix: &'static str) -> ImportError {
        ImportError::Invalid { file: self.file.into(), at, what, fix }
    }
}

/// `length` bytes at `start`, if they are there.
pub(super) fn range(bytes: &[u8], start: usize, length: usize) -> Option<&[u8]> {
    bytes.get(start..start.checked_add(length)?)
}
