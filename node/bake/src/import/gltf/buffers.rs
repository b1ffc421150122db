//! The bytes behind a document: its buffers and the views into them, read a range at a time.

use std::path::{Path, PathBuf};

use super::accessor::SparseElements;
use super::compressed;
use super::document::{BufferView, Document, label};
use crate::import::error::ImportError;
use crate::import::store::Store;
use crate::import::uri::Folder;

/// A parsed document with every buffer at hand, and the file's name for messages.
pub(super) struct Resources<'a> {
    pub(super) file: &'a Path,
    pub(super) document: &'a Document,
    /// The scene file, then one for each buffer in a file or URI of its own, then the decoded views.
    stores: Vec<Store>,
    /// Where each buffer stands; `None` for one that has no bytes, only compressed views.
    buffers: Vec<Option<Span>>,
    /// By number of a buffer view that is compressed: where it stands decoded.
    decoded: Vec<Option<Span>>,
    /// What accessors have been found to replace.
    pub(super) sparse: SparseElements,
}

/// Where an image stands: two that stand in the same place are one.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Origin<'a> {
    Bytes(Span),
    File(PathBuf),
    /// A data URI, or one that leads nowhere.
    Uri(&'a str),
}

/// Bytes of a store that are there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Span {
    store: usize,
    start: u64,
    pub(super) length: u64,
}

impl Span {
    /// `length` bytes at `start` of it, if they are there.
    pub(super) fn part(self, start: usize, length: usize) -> Option<Self> {
        let (start, length) = (start as u64, length as u64);
        let end = start.checked_add(length)?;
        (end <= self.length).then(|| Self { start: self.start + start, length, ..self })
    }
}

impl<'a> Resources<'a> {
    /// Finds every buffer. `bin` is where the binary chunk of a GLB stands in `scene`; it stands for
    /// a first buffer without a URI (glTF 2.0, section 4.4.3.1).
    pub(super) fn load(
        file: &'a Path,
        document: &'a Document,
        scene: Store,
        bin: Option<std::ops::Range<u64>>,
    ) -> Result<Self, ImportError> {
        let bin = bin.map(|bin| Span { store: 0, start: bin.start, length: bin.end - bin.start });
        let mut resources = Self {
            file,
            document,
            stores: vec![scene],
            buffers: Vec::with_capacity(document.buffers.len()),
            decoded: Vec::new(),
            sparse: SparseElements::default(),
        };
        for number in 0..document.buffers.len() {
            let span = resources.buffer(number, bin)?;
            resources.buffers.push(span);
        }
        if let Some((store, spans)) = compressed::decode_all(&resources)? {
            let number = resources.stores.len();
            let span = |(start, length)| Span { store: number, start, length };
            resources.stores.push(store);
            resources.decoded = spans.into_iter().map(|place| place.map(span)).collect();
        }
        Ok(resources)
    }

    fn buffer(&mut self, number: usize, bin: Option<Span>) -> Result<Option<Span>, ImportError> {
        let buffer = &self.document.buffers[number];
        let at = format!("buffer {number}");
        let whole = match (&buffer.uri, bin) {
            (Some(uri), _) => {
                let store = Folder { file: self.file, by: self.file }.open(&at, uri)?;
                let span = Span { store: self.stores.len(), start: 0, length: store.length() };
                self.stores.push(store);
                span
            }
            (None, Some(chunk)) if number == 0 => chunk,
            (None, _) if buffer.extensions.is_fallback() => return Ok(None),
            (None, _) => {
                let what = "it has neither a URI nor the file's binary chunk".into();
                return Err(self.invalid(at, what, "export the file again, with its buffers"));
            }
        };
        match whole.part(0, buffer.byte_length) {
            Some(span) => Ok(Some(span)),
            None => {
                let what =
                    format!("it claims {} bytes and has {}", buffer.byte_length, whole.length);
                Err(self.invalid(at, what, "export or copy the file again"))
            }
        }
    }

    /// Bytes in all buffers together: no honest count of anything exceeds it.
    pub(super) fn total_bytes(&self) -> u64 {
        self.buffers.iter().chain(&self.decoded).flatten().map(|span| span.length).sum()
    }

    /// Where a buffer view stands and its stride, if it names one; `at` names who asks.
    pub(super) fn view(
        &self,
        at: &str,
        number: usize,
    ) -> Result<(Span, Option<usize>), ImportError> {
        let view = self.view_def(at, number)?;
        if let Some(&Some(span)) = self.decoded.get(number) {
            let stride = view.extensions.compression().map(|meshopt| meshopt.byte_stride);
            return Ok((span, stride.or(view.byte_stride)));
        }
        let span = self.part(at, number, view.buffer, view.byte_offset, view.byte_length)?;
        // Some exporters write 0 where they mean "tightly packed".
        Ok((span, view.byte_stride.filter(|&stride| stride != 0)))
    }

    pub(super) fn view_def(&self, at: &str, number: usize) -> Result<&BufferView, ImportError> {
        let views = &self.document.buffer_views;
        views.get(number).ok_or_else(|| {
            self.broken(at, format!("it refers to buffer view {number} of {}", views.len()))
        })
    }

    /// A range of a buffer that view `number` takes.
    pub(super) fn part(
        &self,
        at: &str,
        number: usize,
        buffer: usize,
        start: usize,
        length: usize,
    ) -> Result<Span, ImportError> {
        let whole = self.buffers.get(buffer).ok_or_else(|| {
            let has = self.buffers.len();
            self.broken(at, format!("its buffer view {number} refers to buffer {buffer} of {has}"))
        })?;
        let whole = whole.ok_or_else(|| {
            self.broken(
                at,
                format!("its buffer view {number} refers to buffer {buffer}, which has no bytes"),
            )
        })?;
        whole.part(start, length).ok_or_else(|| {
            let has = whole.length;
            self.broken(
                at,
                format!(
                    "its buffer view {number} takes {length} bytes at {start} of a buffer of {has}"
                ),
            )
        })
    }

    /// The bytes of a span.
    pub(super) fn bytes(&self, span: Span) -> Result<Vec<u8>, ImportError> {
        let length = usize::try_from(span.length).map_err(|_| {
            self.broken("buffers", format!("{} bytes at once exceed the memory", span.length))
        })?;
        self.stores[span.store]
            .read(span.start, length)
            .map_err(|source| ImportError::Read { file: self.file.into(), source })
    }

    /// Where an image stands; `None` if it stands nowhere.
    pub(super) fn origin(&self, number: usize) -> Option<Origin<'a>> {
        let image = self.document.images.get(number)?;
        match (&image.uri, image.buffer_view) {
            (Some(uri), _) => {
                let file = Folder { file: self.file, by: self.file }.find(uri);
                Some(file.map_or(Origin::Uri(uri), Origin::File))
            }
            (None, Some(view)) => self.view("", view).ok().map(|(span, _)| Origin::Bytes(span)),
            (None, None) => None,
        }
    }

    /// The bytes of an image, embedded or in a file of its own.
    pub(super) fn image(&self, number: usize) -> Result<Vec<u8>, ImportError> {
        let at = self.image_label(number);
        let Some(image) = self.document.images.get(number) else {
            return Err(
                self.broken(&at, format!("the file has {} images", self.document.images.len()))
            );
        };
        match (&image.uri, image.buffer_view) {
            (Some(uri), _) => Folder { file: self.file, by: self.file }.read(&at, uri),
            (None, Some(view)) => self.bytes(self.view(&at, view)?.0),
            (None, None) => Err(self.broken(&at, "it has neither a URI nor a buffer view".into())),
        }
    }

    /// What messages call an image.
    pub(super) fn image_label(&self, number: usize) -> String {
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
