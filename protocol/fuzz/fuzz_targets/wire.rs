//! Any stream of bytes, cut anywhere, is read as messages or refused.
//!
//! Run from `protocol/` with `cargo +nightly fuzz run wire`.
#![no_main]

use libfuzzer_sys::fuzz_target;
use protocol::codec::{Decoder, HEADER_BYTES, encode};
use protocol::message::Message;
use protocol::visible::ChangeReader;
use std::sync::Arc;

fuzz_target!(|bytes: &[u8]| {
    let Some((&cut, stream)) = bytes.split_first() else { return };
    read(stream, usize::from(cut));
    // The checksum stops nearly everything: a second try with the header of a true frame.
    let mut frame = Vec::new();
    encode(&Message::Bye, &mut frame);
    frame.truncate(HEADER_BYTES);
    frame[8..12].copy_from_slice(&(stream.len() as u32).to_le_bytes());
    let crc = crc32c::crc32c_append(crc32c::crc32c(&frame[..12]), stream);
    frame[12..16].copy_from_slice(&crc.to_le_bytes());
    frame.extend(stream);
    read(&frame, usize::from(cut));
});

fn read(stream: &[u8], cut: usize) {
    let mut decoder = Decoder::new();
    for piece in stream.chunks(cut.max(1)) {
        decoder.push(piece);
        while let Ok(Some(message)) = decoder.next() {
            let mut again = Vec::new();
            encode(&message, &mut again);
            if let Message::Delta { chunk, .. } = message {
                let mut reader = ChangeReader::new(Arc::default(), u32::MAX);
                if reader.push(&chunk).is_ok() {
                    reader.finish();
                }
            }
        }
    }
}
