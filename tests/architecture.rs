//! DESIGN's dependency table and house rules, held.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Who may depend on whom in the workspace; ARCHITECTURE.md shows the same table.
const ALLOWED: [(&str, &[&str]); 10] = [
    ("shaders", &[]),
    ("protocol", &[]),
    ("geometry", &[]),
    ("scene", &["protocol", "geometry"]),
    ("gpu", &["scene", "shaders", "protocol"]),
    ("farfield", &["protocol", "geometry", "scene"]),
    ("bake", &["protocol", "geometry", "scene", "farfield"]),
    ("node", &["protocol", "scene", "farfield", "gpu"]),
    ("coordinator", &["protocol"]),
    ("occluster", &["coordinator", "node", "bake", "protocol", "scene"]),
];

/// Packages that may be named only behind one wall.
const WALLS: [(&str, &[&str]); 6] = [
    ("tokio", &["coordinator", "node"]),
    ("memmap2", &["scene"]),
    ("nix", &["scene"]),
    ("wgpu", &["gpu"]),
    ("bincode", &["protocol"]),
    ("meshopt", &["geometry"]),
];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Normal dependencies of each workspace package.
fn dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--format-version=1", "--offline"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    let normal = |package: &serde_json::Value| {
        let all = package["dependencies"].as_array().unwrap().iter();
        all.filter(|d| d["kind"].is_null())
            .map(|d| d["name"].as_str().unwrap().to_owned())
            .collect()
    };
    packages.iter().map(|p| (p["name"].as_str().unwrap().to_owned(), normal(p))).collect()
}

#[test]
fn crates_depend_on_each_other_only_as_the_table_says() {
    let dependencies = dependencies();
    let members: BTreeSet<&str> = dependencies.keys().map(String::as_str).collect();
    assert_eq!(members, ALLOWED.iter().map(|(name, _)| *name).collect());
    for (name, allowed) in ALLOWED {
        for dependency in dependencies[name].iter().filter(|d| members.contains(d.as_str())) {
            assert!(allowed.contains(&dependency.as_str()), "{name} depends on {dependency}");
        }
    }
}

#[test]
fn walled_packages_stay_behind_their_walls() {
    for (name, used) in dependencies() {
        for (package, behind) in WALLS {
            assert!(
                !used.contains(package) || behind.contains(&name.as_str()),
                "{name} uses {package}"
            );
        }
    }
}

#[test]
fn bincode_is_named_in_the_codec_alone() {
    for (path, text) in sources(&root()) {
        if text.contains(concat!("bincode", "::")) {
            assert!(path.ends_with("protocol/src/codec.rs"), "{}", path.display());
        }
    }
}

#[test]
fn no_source_file_is_longer_than_700_lines() {
    let sources = sources(&root());
    assert!(sources.len() > 40);
    for (path, text) in sources {
        assert!(text.lines().count() <= 700, "{}", path.display());
    }
}

#[test]
fn every_rig_file_parses() {
    let mut seen = 0;
    for entry in std::fs::read_dir(root().join("configs")).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let read = match path.file_name().unwrap().to_str().unwrap() {
            "bake.toml" => {
                toml::from_str::<bake::Options>(&text).map(|_| ()).map_err(|e| e.to_string())
            }
            name if name.ends_with(".toml") => toml::from_str::<coordinator::config::Rig>(&text)
                .map(|_| ())
                .map_err(|e| e.to_string()),
            name if name.ends_with(".csv") => {
                coordinator::camera_path::read_csv(&path).map(|_| ()).map_err(|e| e.to_string())
            }
            _ => Err("nothing reads such a file".to_owned()),
        };
        assert_eq!(read, Ok(()), "{}", path.display());
        seen += 1;
    }
    assert!(seen >= 2);
}

/// Rust and WGSL sources outside build folders.
fn sources(folder: &Path) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && name != "target" && !name.starts_with('.') {
            found.extend(sources(&path));
        } else if name.ends_with(".rs") || name.ends_with(".wgsl") {
            let text = std::fs::read_to_string(&path).unwrap();
            found.push((path, text));
        }
    }
    found
}
