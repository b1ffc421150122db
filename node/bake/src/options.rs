//! What a bake may be told.

use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Most triangles of one mesh: even with no vertex shared, 16-bit indices reach all corners.
pub(crate) const MAX_MESH_TRIANGLES: usize = protocol::format::vertex::MAX_BLOB_VERTICES / 3;
/// Largest triangle target: a simplifier may stop a quarter above it.
const MAX_TARGET: usize = 16_384;

/// Less memory than this holds nothing worth a stage of its own.
const LEAST_MEMORY: u64 = 16 << 20;

/// Settings of a bake; `configs/bake.toml` explains each and holds the defaults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Worker threads; 0 takes one a processor. The output does not depend on it.
    pub jobs: usize,
    /// Bytes of memory to work in, beside the program itself and the skeleton. The output does not
    /// depend on it.
    pub memory: u64,
    /// Stored with the scene.
    pub seed: u64,
    /// Most triangles of a leaf.
    pub piece_triangles: usize,
    /// Longest side of a leaf that is not split for its extent, as a share of the scene's diagonal.
    pub piece_extent: f64,
    /// Fewest triangles of a piece that was split off for its extent alone.
    pub piece_least_triangles: usize,
    /// Pixels along each side of the largest texture: a power of two.
    pub texture_side: u32,
    /// Name or number of the scene to read of a glTF that holds several; empty for its default one.
    pub scene: String,
    /// Most children of an inner hlod.
    pub branching: usize,
    /// Triangles of the finest level of an inner hlod.
    pub hlod_triangles: usize,
    /// Most levels an inner hlod is given at first, the root apart; more follow where the step to its
    /// parent is large.
    pub hlod_levels: usize,
    /// No level is made from a mesh of this many triangles or fewer.
    pub level_least_triangles: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            jobs: 0,
            memory: 1 << 30,
            seed: 0,
            piece_triangles: 2048,
            piece_extent: 0.0625,
            piece_least_triangles: 128,
            texture_side: 512,
            scene: String::new(),
            branching: 4,
            hlod_triangles: 2048,
            hlod_levels: 1,
            level_least_triangles: 16,
        }
    }
}

/// Why settings cannot be used. Exit code 78.
#[derive(Debug, thiserror::Error)]
pub enum OptionsError {
    /// The file cannot be read.
    #[error("{}: cannot read it: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file is no valid TOML, or names an unknown key.
    #[error("{}: {source}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: Box<toml::de::Error>,
    },
    /// A value no bake can work with.
    #[error("bake setting {key} = {value}: must be {expected}")]
    Range {
        /// The setting.
        key: &'static str,
        /// What it was.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
}

impl Options {
    /// Reads a TOML file; keys left out keep their defaults.
    pub fn from_file(path: &Path) -> Result<Self, OptionsError> {
        let to_read = |source| OptionsError::Read { path: path.to_path_buf(), source };
        let text = protocol::file::read_settings(path).map_err(to_read)?;
        let options: Self = toml::from_str(&text).map_err(|source| OptionsError::Parse {
            path: path.to_path_buf(),
            source: Box::new(source),
        })?;
        options.check()?;
        Ok(options)
    }

    /// Refuses values out of range.
    pub fn check(&self) -> Result<(), OptionsError> {
        let hold = |kept: bool, key, value, expected| {
            if kept { Ok(()) } else { Err(OptionsError::Range { key, value, expected }) }
        };
        for (key, value) in
            [("piece_triangles", self.piece_triangles), ("hlod_triangles", self.hlod_triangles)]
        {
            hold((1..=MAX_TARGET).contains(&value), key, value as f64, "1 to 16384")?;
        }
        let branching = self.branching;
        hold((2..=16).contains(&branching), "branching", branching as f64, "2 to 16")?;
        let levels = self.hlod_levels;
        hold((1..=16).contains(&levels), "hlod_levels", levels as f64, "1 to 16")?;
        let side = self.texture_side;
        let is_side = side.is_power_of_two() && side <= 4096;
        hold(is_side, "texture_side", f64::from(side), "a power of two, at most 4096")?;
        let memory = self.memory;
        hold(memory >= LEAST_MEMORY, "memory", memory as f64, "at least 16777216 (16MiB)")?;
        let extent = self.piece_extent;
        hold(extent > 0.0 && extent <= 1.0, "piece_extent", extent, "above 0, at most 1")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_documented_file_holds_the_defaults() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/bake.toml");
        assert_eq!(Options::from_file(&path).unwrap(), Options::default());
        let text = std::fs::read_to_string(path).unwrap();
        let serde_json::Value::Object(keys) = serde_json::to_value(Options::default()).unwrap()
        else {
            panic!("options are a table")
        };
        keys.keys().for_each(|key| assert!(text.contains(&format!("\n{key} = ")), "{key}"));
    }

    #[test]
    fn bad_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bake.toml");
        assert!(matches!(Options::from_file(&path), Err(OptionsError::Read { .. })));
        for (text, says) in [
            ("piece_triangle = 3", "unknown field"),
            ("branching = 1", "branching"),
            ("piece_triangles = 0", "piece_triangles"),
            ("hlod_triangles = 99999", "16384"),
            ("piece_extent = nan", "piece_extent"),
            ("hlod_levels = 0", "hlod_levels"),
            ("jobs = -1", "jobs"),
            ("texture_side = 500", "power of two"),
            ("memory = 1000", "16MiB"),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = Options::from_file(&path).unwrap_err().to_string();
            assert!(message.contains(says), "{text}: {message}");
        }
    }
}
