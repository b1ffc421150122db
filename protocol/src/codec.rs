//! Frames: a message with its length, layout version and checksum. WIRE.md draws the bytes.
//!
//! bincode is named in this file alone.

use crate::message::Message;
use serde::Deserialize;
use serde::de::{Deserializer, SeqAccess, Visitor};
use std::marker::PhantomData;

/// First bytes of every frame.
pub const MAGIC: [u8; 4] = *b"OCCW";
/// Version of the frame around a message; the messages' own is [`crate::message::WIRE_VERSION`].
pub const LAYOUT_VERSION: u32 = 1;
/// Bytes before the body: magic, layout version, length, CRC32C.
pub const HEADER_BYTES: usize = 16;
/// Longest body before the other end has proved that it knows the token.
pub const MAX_BODY_BEFORE_HANDSHAKE: usize = 64 << 10;
/// Longest body after that.
pub const MAX_BODY: usize = 1 << 20;
/// Least memory limit of a decoded body.
const SMALLEST_LIMIT: usize = 256;

/// Why bytes make no message. The link is of no more use.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// Not a frame of this protocol.
    #[error("this is not the occluster protocol (frame begins with {0:02x?})")]
    Foreign([u8; 4]),
    /// A frame of another layout version.
    #[error("the frame has layout version {0}, this program reads version {LAYOUT_VERSION}")]
    Layout(u32),
    /// The body is longer than is allowed at this time.
    #[error("the frame claims {claimed} bytes, {allowed} are allowed")]
    TooLong {
        /// Claimed length of the body.
        claimed: usize,
        /// Longest allowed.
        allowed: usize,
    },
    /// The bytes were changed on the way.
    #[error("the frame's checksum does not match")]
    Checksum,
    /// The body is no message.
    #[error("the frame holds no message of this version: {0}")]
    Body(String),
}

/// Appends the frame of `message` to `out`.
///
/// # Panics
/// If the body exceeds [`MAX_BODY`]: the session cuts changes into chunks far below it.
pub fn encode(message: &Message, out: &mut Vec<u8>) {
    let start = out.len();
    out.extend(MAGIC);
    out.extend(LAYOUT_VERSION.to_le_bytes());
    out.extend([0; 8]);
    let config = bincode::config::standard().with_little_endian().with_fixed_int_encoding();
    let written = bincode::serde::encode_into_std_write(message, out, config);
    assert!(written.is_ok(), "every message can be written to memory: {written:?}");
    let length = out.len() - start - HEADER_BYTES;
    assert!(length <= MAX_BODY, "a message of {length} bytes is longer than any peer would read");
    out[start + 8..start + 12].copy_from_slice(&(length as u32).to_le_bytes());
    let frame = &out[start..];
    let crc = checksum(&frame[..12], &frame[HEADER_BYTES..]);
    out[start + 12..start + HEADER_BYTES].copy_from_slice(&crc.to_le_bytes());
}

/// Finds messages in a stream of bytes that arrives in pieces of any size.
///
/// Holds what was pushed and no more: a claimed length allocates nothing.
#[derive(Debug)]
pub struct Decoder {
    bytes: Vec<u8>,
    /// Bytes already made into messages.
    consumed: usize,
    max_body: usize,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// For a link whose other end is not known yet: [`MAX_BODY_BEFORE_HANDSHAKE`].
    pub fn new() -> Self {
        Self { bytes: Vec::new(), consumed: 0, max_body: MAX_BODY_BEFORE_HANDSHAKE }
    }

    /// The other end knows the token: from now on [`MAX_BODY`].
    pub fn handshake_done(&mut self) {
        self.max_body = MAX_BODY;
    }

    /// Takes bytes as they arrived.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.consumed);
        self.consumed = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next whole message; none until more bytes come.
    #[expect(clippy::should_implement_trait, reason = "ends in an error, unlike an iterator")]
    pub fn next(&mut self) -> Result<Option<Message>, CodecError> {
        let frame = &self.bytes[self.consumed..];
        let Some((header, rest)) = frame.split_first_chunk::<HEADER_BYTES>() else {
            return refuse_foreign(frame).map(|()| None);
        };
        refuse_foreign(header)?;
        let word = |at: usize| {
            u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
        };
        if word(4) != LAYOUT_VERSION {
            return Err(CodecError::Layout(word(4)));
        }
        let length = word(8) as usize;
        if length > self.max_body {
            return Err(CodecError::TooLong { claimed: length, allowed: self.max_body });
        }
        let Some(body) = rest.get(..length) else { return Ok(None) };
        if checksum(&header[..12], body) != word(12) {
            return Err(CodecError::Checksum);
        }
        let message = decode_body(body)?;
        self.consumed += HEADER_BYTES + length;
        Ok(Some(message))
    }

    /// Whether the stream could end here: no part of a message is held.
    pub fn is_between_messages(&self) -> bool {
        self.consumed == self.bytes.len()
    }
}

/// A foreign peer is known by its first byte, however few it sends.
fn refuse_foreign(frame: &[u8]) -> Result<(), CodecError> {
    let present = frame.len().min(MAGIC.len());
    if frame[..present] == MAGIC[..present] {
        return Ok(());
    }
    let mut first = [0; 4];
    first[..present].copy_from_slice(&frame[..present]);
    Err(CodecError::Foreign(first))
}

/// CRC32C of the first 12 header bytes and the body: a damaged length is found as well.
fn checksum(head: &[u8], body: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(head), body)
}

/// Decodes a whole body.
///
/// bincode allocates a text or code as long as is claimed, up to a limit that is part of its type.
/// The least of a few limits that holds the body keeps that below four times what is present.
fn decode_body(body: &[u8]) -> Result<Message, CodecError> {
    match body.len() {
        0..=SMALLEST_LIMIT => decode_limited::<SMALLEST_LIMIT>(body),
        257..=1024 => decode_limited::<1024>(body),
        1025..=4096 => decode_limited::<4096>(body),
        4097..=16_384 => decode_limited::<16_384>(body),
        16_385..=65_536 => decode_limited::<65_536>(body),
        65_537..=262_144 => decode_limited::<262_144>(body),
        _ => decode_limited::<MAX_BODY>(body),
    }
}

fn decode_limited<const LIMIT: usize>(body: &[u8]) -> Result<Message, CodecError> {
    let config = bincode::config::standard()
        .with_little_endian()
        .with_fixed_int_encoding()
        .with_limit::<LIMIT>();
    let (message, used) = bincode::serde::decode_from_slice(body, config)
        .map_err(|error| CodecError::Body(error.to_string()))?;
    // bincode itself is silent about bytes that follow.
    if used != body.len() {
        return Err(CodecError::Body(format!("{} bytes follow it", body.len() - used)));
    }
    Ok(message)
}

/// Reads a list element by element: a claimed length reserves nothing.
pub(crate) fn list<'de, D, T>(deserializer: D) -> Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Elements<T>(PhantomData<T>);
    impl<'de, T: Deserialize<'de>> Visitor<'de> for Elements<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("a list")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Vec<T>, A::Error> {
            let mut list = Vec::new();
            while let Some(element) = elements.next_element()? {
                list.push(element);
            }
            Ok(list)
        }
    }
    deserializer.deserialize_seq(Elements(PhantomData))
}

/// Bytes as one block rather than a list of numbers, so that the limit covers them.
pub(crate) mod bytes {
    use serde::de::{Deserializer, Visitor};
    use serde::ser::Serializer;

    struct Block;

    impl Visitor<'_> for Block {
        type Value = Vec<u8>;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("bytes")
        }

        fn visit_byte_buf<E>(self, bytes: Vec<u8>) -> Result<Vec<u8>, E> {
            Ok(bytes)
        }
    }

    /// Writes the length, then the bytes.
    pub(crate) fn serialize<S: Serializer>(bytes: &[u8], to: S) -> Result<S::Ok, S::Error> {
        to.serialize_bytes(bytes)
    }

    /// Reads what `serialize` wrote.
    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<u8>, D::Error> {
        from.deserialize_byte_buf(Block)
    }
}

#[cfg(test)]
#[path = "codec_tests.rs"]
mod tests;
