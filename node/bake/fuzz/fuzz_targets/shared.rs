//! What the targets share: a file is read, and neither panics nor takes memory that it has no bytes for.

use bake::import::ImportLimits;
use std::cell::OnceCell;

thread_local! {
    static FOLDER: OnceCell<tempfile::TempDir> = const { OnceCell::new() };
}

/// Reads `bytes` as a scene file of this name. A library of materials may follow a line `--- mtl`.
pub fn read(name: &str, bytes: &[u8]) {
    FOLDER.with(|folder| {
        let folder = folder.get_or_init(|| tempfile::tempdir().expect("a folder"));
        const MARK: &[u8] = b"--- mtl\n";
        let mark = bytes.windows(MARK.len()).position(|word| word == MARK);
        let (scene, library) = match mark {
            Some(at) => (&bytes[..at], &bytes[at + MARK.len()..]),
            None => (bytes, &b""[..]),
        };
        let file = folder.path().join(name);
        std::fs::write(&file, scene).expect("a file");
        std::fs::write(folder.path().join("scene.mtl"), library).expect("a file");
        let _ = bake::import::references(&file);
        let _ = bake::survey::survey(&file, &ImportLimits { texture_side: 64, memory: 1 << 24, ..ImportLimits::default() });
    });
}
