//! What the promises share: running the program, making scenes, reading what it wrote.

#![allow(dead_code, reason = "every test file uses its own part")]
#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use tempfile::TempDir;

/// The program, in a clean environment.
pub(crate) fn occluster() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_occluster"));
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("OCCLUSTER_")) {
        command.env_remove(name);
    }
    command
}

/// Runs the program; stops the test with its stderr unless it succeeded.
pub(crate) fn succeed(arguments: &[&str]) -> Output {
    let output = occluster().args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    output
}

/// Runs the program, expects this exit code, a message on stderr that holds `says`, and no panic.
pub(crate) fn fail(arguments: &[&str], code: i32, says: &str) {
    let output = occluster().args(arguments).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(!stderr.contains("panicked"), "{arguments:?}: {stderr}");
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
    assert!(stderr.contains(says), "{arguments:?} does not say `{says}`: {stderr}");
}

/// A backend to test, by its flag.
pub(crate) const CPU: &str = "cpu";
/// Likewise.
pub(crate) const GPU: &str = "gpu";

/// The backends of this machine. `GPU_TESTS=require` insists on a graphics driver, `off` leaves it
/// out, `auto` (the default) uses one if there is one and says so if not.
pub(crate) fn backends() -> Vec<&'static str> {
    static HAS_DRIVER: OnceLock<bool> = OnceLock::new();
    let has_driver = || {
        *HAS_DRIVER.get_or_init(|| {
            let report = String::from_utf8(succeed(&["doctor"]).stdout).unwrap();
            report.contains("would use: gpu")
        })
    };
    match std::env::var("GPU_TESTS").as_deref() {
        Ok("off") => vec![CPU],
        Ok("require") => {
            assert!(has_driver(), "GPU_TESTS=require, but there is no graphics driver");
            vec![CPU, GPU]
        }
        _ if has_driver() => vec![CPU, GPU],
        _ => {
            eprintln!("skipped on the GPU backend: no graphics driver here");
            vec![CPU]
        }
    }
}

/// A folder with a baked scene.
pub(crate) struct Scene {
    folder: TempDir,
    /// The scene file.
    pub(crate) occ: PathBuf,
}

impl Scene {
    /// Generates and bakes.
    pub(crate) fn synth(kind: &str, triangles: u64) -> Self {
        let folder = TempDir::new().unwrap();
        let glb = folder.path().join("source.glb");
        succeed(&["synth", kind, "-o", text(&glb), "--triangles", &triangles.to_string()]);
        Self::bake_into(folder, &glb)
    }

    /// Bakes a GLB.
    pub(crate) fn bake(glb: &Path) -> Self {
        Self::bake_into(TempDir::new().unwrap(), glb)
    }

    fn bake_into(folder: TempDir, glb: &Path) -> Self {
        let occ = folder.path().join("scene.occ");
        succeed(&["bake", text(glb), "-o", text(&occ)]);
        Self { folder, occ }
    }

    /// A name in the scene's folder.
    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A generated path.
    pub(crate) fn path(&self, kind: &str, frames: u32) -> PathBuf {
        self.path_by_seed(kind, frames, 1)
    }

    /// One by another seed.
    pub(crate) fn path_by_seed(&self, kind: &str, frames: u32, seed: u32) -> PathBuf {
        let csv = self.file(&format!("{kind}-{frames}-{seed}.csv"));
        succeed(&[
            "path",
            text(&self.occ),
            "-o",
            text(&csv),
            "--kind",
            kind,
            "--frames",
            &frames.to_string(),
            "--seed",
            &seed.to_string(),
        ]);
        csv
    }

    /// Replays into a folder of its own.
    pub(crate) fn replay(&self, name: &str, options: &[&str]) -> Run {
        let out = self.file(name);
        let mut arguments = vec!["replay", text(&self.occ), "--out", text(&out)];
        arguments.extend(options);
        succeed(&arguments);
        Run::read(&out)
    }
}

/// What a replay wrote.
pub(crate) struct Run {
    /// Where.
    pub(crate) out: PathBuf,
    /// `summary.json`.
    pub(crate) summary: Value,
    /// `frames.csv`, by column name.
    pub(crate) rows: Vec<std::collections::HashMap<String, String>>,
}

impl Run {
    /// The picture of a frame.
    pub(crate) fn picture(&self, frame: usize) -> image::RgbImage {
        image::open(self.out.join(format!("frames/{frame:06}.png"))).unwrap().into_rgb8()
    }

    /// Reads a run's folder.
    pub(crate) fn read(out: &Path) -> Self {
        let summary =
            serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap())
                .unwrap();
        let mut reader = csv::Reader::from_path(out.join("frames.csv")).unwrap();
        Self {
            out: out.to_owned(),
            summary,
            rows: reader.deserialize().map(Result::unwrap).collect(),
        }
    }

    /// A column of `frames.csv`.
    pub(crate) fn column(&self, name: &str) -> Vec<&str> {
        self.rows.iter().map(|row| row[name].as_str()).collect()
    }

    /// Hashes of all pictures.
    pub(crate) fn hashes(&self) -> Vec<&str> {
        let hashes = self.column("picture_hash");
        assert!(hashes.iter().all(|hash| hash.len() == 16), "{hashes:?}");
        hashes
    }

    /// A number of the summary, by its path of keys.
    pub(crate) fn number(&self, pointer: &str) -> f64 {
        self.summary
            .pointer(pointer)
            .and_then(Value::as_f64)
            .unwrap_or_else(|| panic!("{pointer} is no number"))
    }

    /// Every frame was audited, no pixel differs and no front is wrong.
    pub(crate) fn assert_audited(&self, what: &str) {
        assert_eq!(self.number("/audit/frames"), self.number("/frames"), "{what}");
        assert_eq!(
            self.number("/audit/differing_pixels"),
            0.0,
            "{what}: {}",
            self.summary["audit"]
        );
        assert_eq!(self.number("/audit/front_faults"), 0.0, "{what}");
    }
}

/// A path as an argument.
pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A real scene, or none (said on stderr) where the folder beside the project is not there.
pub(crate) fn real_scene(name: &str) -> Option<PathBuf> {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes").join(format!("{name}.glb"));
    if !path.exists() {
        eprintln!("skipped {name}: no {}", path.display());
        return None;
    }
    Some(path)
}

/// A path through everything in a real scene, or none where it is not there.
pub(crate) fn rough_path(name: &str, seed: u32) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes/paths");
    let path = folder.join(format!("{name}-{seed}.csv"));
    path.exists().then_some(path)
}

/// The five real scenes.
pub(crate) const REAL_SCENES: [&str; 5] = [
    "indoor_schependomlaan",
    "indoor_aws_small_house",
    "city_wageningen",
    "cad_ldraw_town_hall",
    "outdoor_genesis_plaza_street",
];
