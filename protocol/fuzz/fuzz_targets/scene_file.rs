//! Any bytes are read as a scene file or refused.
//!
//! Run from `protocol/` with `cargo +nightly fuzz run scene_file`.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = protocol::format::read::parse(bytes);
});
