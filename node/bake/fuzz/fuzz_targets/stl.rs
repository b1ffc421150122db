//! A scene file ending in `.stl`.

#![no_main]

mod shared;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| shared::read("scene.stl", bytes));
