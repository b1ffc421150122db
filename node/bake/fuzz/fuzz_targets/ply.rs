//! A scene file ending in `.ply`.

#![no_main]

mod shared;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| shared::read("scene.ply", bytes));
