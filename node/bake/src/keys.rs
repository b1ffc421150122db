//! What each stage of a bake depends on, as digests.

use crate::import::{ImportError, check_readable, references};
use crate::options::Options;
use crate::work::Key;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Counts up whenever a bake of the same sources and settings would write other bytes, or files of the
/// working folder would be read in another way.
const BAKE_VERSION: u32 = 7;

/// Bytes of a file that are read at once.
const DIGEST_BYTES: usize = 4 << 20;

/// Digests of all a stage's inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Keys {
    /// Of the imported scene.
    pub(crate) import: Key,
    /// Of the pieces.
    pub(crate) pieces: Key,
    /// Of the scene file.
    pub(crate) scene: Key,
}

impl Keys {
    /// For these source files and all they refer to.
    pub(crate) fn of_files(inputs: &[PathBuf], options: &Options) -> Result<Self, ImportError> {
        let mut hasher = blake3::Hasher::new();
        for input in inputs {
            check_readable(input)?;
            for file in std::iter::once(input.clone()).chain(references(input)?) {
                // A file that is missing is the importer's to judge.
                let digest = digest(&file).unwrap_or([0; 32]);
                let name = file.file_name().unwrap_or_default().as_encoded_bytes();
                hasher.update(&(name.len() as u64).to_le_bytes()).update(name).update(&digest);
            }
        }
        Ok(Self::of_content(hasher.finalize().into(), options))
    }

    /// For sources with this digest.
    pub(crate) fn of_content(content: Key, options: &Options) -> Self {
        let scene: Key = blake3::hash(options.scene.as_bytes()).into();
        let content = digest_of(&content, &scene.map(f64::from));
        let import =
            digest_of(&content, &[f64::from(BAKE_VERSION), f64::from(options.texture_side)]);
        let pieces = digest_of(
            &import,
            &[
                options.piece_triangles as f64,
                options.piece_extent,
                options.piece_least_triangles as f64,
            ],
        );
        let scene = digest_of(
            &pieces,
            &[
                options.branching as f64,
                options.hlod_triangles as f64,
                options.hlod_levels as f64,
                options.level_least_triangles as f64,
                // A seed has 64 bits, a number 53 of them.
                (options.seed >> 32) as f64,
                (options.seed & 0xffff_ffff) as f64,
            ],
        );
        Self { import, pieces, scene }
    }
}

/// The content of a source that nobody can name: no two are alike.
pub(crate) fn unknown() -> Key {
    let mut hasher = blake3::Hasher::new();
    let now = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
    hasher.update(&std::process::id().to_le_bytes()).update(&now.as_nanos().to_le_bytes());
    hasher.finalize().into()
}

fn digest_of(before: &Key, settings: &[f64]) -> Key {
    let mut hasher = blake3::Hasher::new();
    hasher.update(before);
    for setting in settings {
        hasher.update(&setting.to_le_bytes());
    }
    hasher.finalize().into()
}

/// Of a file's content, by all threads: its blocks are large enough for that.
fn digest(path: &Path) -> std::io::Result<Key> {
    let mut hasher = blake3::Hasher::new();
    let mut file = protocol::file::open(path)?;
    let mut block = vec![0; DIGEST_BYTES];
    loop {
        match file.read(&mut block)? {
            0 => return Ok(hasher.finalize().into()),
            read => hasher.update_rayon(&block[..read]),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_hear_of_their_own_settings_alone() {
        let plain = Keys::of_content([7; 32], &Options::default());
        let with = |change: fn(&mut Options)| {
            let mut options = Options::default();
            change(&mut options);
            let keys = Keys::of_content([7; 32], &options);
            [keys.import == plain.import, keys.pieces == plain.pieces, keys.scene == plain.scene]
        };
        assert_eq!(with(|o| o.jobs = 3), [true, true, true]);
        assert_eq!(with(|o| o.memory *= 2), [true, true, true]);
        assert_eq!(with(|o| o.seed = 1 << 33), [true, true, false]);
        assert_eq!(with(|o| o.hlod_levels += 1), [true, true, false]);
        assert_eq!(with(|o| o.piece_triangles += 1), [true, false, false]);
        assert_eq!(with(|o| o.texture_side /= 2), [false, false, false]);
        assert_eq!(with(|o| o.scene = "1".into()), [false, false, false]);
    }

    #[test]
    fn a_file_that_a_scene_refers_to_counts() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("a.gltf");
        let buffer = folder.path().join("a b.bin");
        std::fs::write(&scene, br#"{"buffers":[{"uri":"a%20b.bin","byteLength":3}]}"#).unwrap();
        std::fs::write(&buffer, b"one").unwrap();
        let keys = || Keys::of_files(std::slice::from_ref(&scene), &Options::default()).unwrap();
        let before = keys();
        assert_eq!(before, keys());
        std::fs::write(&buffer, b"two").unwrap();
        assert_ne!(before, keys());
        std::fs::remove_file(&buffer).unwrap();
        assert_ne!(before, keys());
    }
}
