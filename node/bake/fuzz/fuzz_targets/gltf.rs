//! A scene file ending in `.glb`.

#![no_main]

mod shared;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| shared::read("scene.glb", bytes));
