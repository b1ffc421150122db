//! A bake that is killed, interrupted or out of space leaves the old scene alone, keeps what is
//! finished, and goes on when it is run again: to the very bytes of a bake that nothing disturbed.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]
#![cfg(unix)]

mod support;

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use support::{occluster, succeed, text};
use tempfile::TempDir;

/// A plant, and what a bake of it writes.
struct Plant {
    folder: TempDir,
    glb: PathBuf,
    occ: PathBuf,
    whole: Vec<u8>,
}

/// What lies beside a scene once all is done.
const DONE: [&str; 2] = ["plant.glb", "plant.occ"];
const WORK: &str = ".plant.occ.bake";

impl Plant {
    fn new(triangles: u32) -> Self {
        let folder = TempDir::new().unwrap();
        let (glb, occ) = (folder.path().join("plant.glb"), folder.path().join("plant.occ"));
        succeed(&["synth", "plant", "-o", text(&glb), "--triangles", &triangles.to_string()]);
        let mut plant = Self { folder, glb, occ, whole: Vec::new() };
        assert!(plant.bake().status.success());
        plant.whole = std::fs::read(&plant.occ).unwrap();
        std::fs::remove_file(&plant.occ).unwrap();
        plant
    }

    fn arguments(&self) -> [&str; 6] {
        ["bake", text(&self.glb), "-o", text(&self.occ), "--memory", "16MiB"]
    }

    fn bake(&self) -> Output {
        occluster().args(self.arguments()).output().unwrap()
    }

    /// Starts a bake, sends it a signal once the working folder has so many bytes of a scene, and waits.
    fn signalled(&self, signal: &str, bytes: u64) -> Output {
        let mut bake = occluster();
        bake.args(self.arguments()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut bake = bake.spawn().unwrap();
        let scene = self.folder.path().join(WORK).join("scene");
        let deadline = Instant::now() + Duration::from_secs(60);
        while std::fs::metadata(&scene).map_or(0, |scene| scene.len()) < bytes {
            assert!(Instant::now() < deadline, "it never wrote {bytes} bytes");
            assert!(bake.try_wait().unwrap().is_none(), "it ended before it wrote {bytes} bytes");
            std::thread::sleep(Duration::from_millis(2));
        }
        let kill = format!("kill -{signal} {}", bake.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        bake.wait_with_output().unwrap()
    }

    /// The same command finishes the scene, and nothing is left behind.
    fn assert_goes_on(&self, what: &str) {
        let output = self.bake();
        assert!(output.status.success(), "{what}: {}", String::from_utf8_lossy(&output.stderr));
        assert!(std::fs::read(&self.occ).unwrap() == self.whole, "{what}: other bytes");
        assert_eq!(names(self.folder.path()), DONE, "{what}");
    }
}

/// Names in a folder, sorted.
fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_killed_or_interrupted_bake_goes_on() {
    let plant = Plant::new(120_000);
    for (signal, share) in [("INT", 4), ("TERM", 3), ("KILL", 2)] {
        let output = plant.signalled(signal, plant.whole.len() as u64 / share / 2);
        let says = String::from_utf8(output.stderr).unwrap();
        if signal == "KILL" {
            assert_eq!(output.status.code(), None, "{says}");
        } else {
            assert_eq!(output.status.code(), Some(1), "{says}");
            assert!(says.contains(WORK) && says.contains("goes on"), "{says}");
        }
        assert_eq!(names(plant.folder.path()), [WORK, "plant.glb"], "{signal}");
    }
    plant.assert_goes_on("after three signals");
    // A scene that is there stays until the new one is whole.
    std::fs::write(&plant.occ, b"an old scene").unwrap();
    plant.signalled("KILL", plant.whole.len() as u64 / 4);
    assert_eq!(std::fs::read(&plant.occ).unwrap(), b"an old scene");
    plant.assert_goes_on("over an old scene");
}

#[test]
fn a_bake_that_nobody_hears_ends_at_a_signal() {
    let plant = Plant::new(120_000);
    for signal in ["INT", "TERM"] {
        let mut bake = occluster();
        bake.args(plant.arguments()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut bake = bake.spawn().unwrap();
        drop(bake.stderr.take());
        let work = plant.folder.path().join(WORK);
        let deadline = Instant::now() + Duration::from_secs(60);
        while !work.join("meshes").exists() {
            assert!(Instant::now() < deadline, "it never began");
            std::thread::sleep(Duration::from_millis(2));
        }
        let kill = format!("kill -{signal} {}", bake.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        assert_eq!(bake.wait().unwrap().code(), Some(1), "{signal}");
        assert!(!plant.occ.exists(), "{signal}");
        std::fs::remove_dir_all(&work).unwrap();
    }
}

#[test]
fn a_scene_kept_for_its_far_fields_is_made_again_where_it_is_damaged() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (glb, far, kept) = (at("pipes.glb"), at("far.occ"), at(".far.occ.far"));
    succeed(&["synth", "pipes", "-o", text(&glb), "--triangles", "3000"]);
    std::fs::create_dir(&kept).unwrap();
    let plain = kept.join("plain.occ");
    succeed(&["bake", text(&glb), "-o", text(&plain)]);
    let walk = at("walk.csv");
    succeed(&["path", text(&plain), "-o", text(&walk), "--frames", "4"]);
    let mut bytes = std::fs::read(&plain).unwrap();
    let third = bytes.len() / 3;
    bytes[third] ^= 4;
    std::fs::write(&plain, bytes).unwrap();
    let make = ["bake", text(&glb), "-o", text(&far), "--far", "tdm", "--cells-along", text(&walk)];
    succeed(&[&make[..], &["--far-side", "64", "--far-samples", "1", "--far-always"]].concat());
    succeed(&["verify", text(&far)]);
    assert!(!kept.exists());
}

/// Runs a bake that can write no file beyond so many blocks of 512 bytes.
fn bake_within(plant: &Plant, blocks: u64) -> Output {
    // Told instead of killed, as on a full disk.
    let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$@\"");
    let program = occluster();
    let mut shell = Command::new("sh");
    shell.args(["-c", &script, "sh", text(Path::new(program.get_program()))]);
    shell.args(plant.arguments()).output().unwrap()
}

#[test]
fn a_full_disk_is_said_and_the_bake_goes_on_when_there_is_space() {
    let plant = Plant::new(60_000);
    std::fs::write(&plant.occ, b"an old scene").unwrap();
    // From hardly anything to just too little for the scene.
    let most = plant.whole.len() as u64 / 512;
    for blocks in [0, 1, most / 10, most / 2, most - 1] {
        let output = bake_within(&plant, blocks);
        let says = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(74), "{blocks}: {says}");
        assert!(says.contains("plant.") && !says.contains("panicked"), "{blocks}: {says}");
        assert!(says.contains("space"), "{blocks}: {says}");
        assert_eq!(std::fs::read(&plant.occ).unwrap(), b"an old scene", "{blocks}");
    }
    plant.assert_goes_on("with space again");
}

#[test]
fn a_limit_on_the_size_of_files_is_said_as_a_full_disk_is() {
    let scene = support::Scene::synth("pipes", 3_000);
    let out = scene.file("run");
    let within = |blocks: u32, arguments: &[&str]| {
        let script = format!("ulimit -f {blocks}; exec \"$@\"");
        let program = occluster();
        let mut shell = Command::new("sh");
        shell.args(["-c", &script, "sh", text(Path::new(program.get_program()))]).args(arguments);
        let output = shell.output().unwrap();
        let says = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(74), "{arguments:?}: {says}");
    };
    within(0, &["synth", "pipes", "--triangles", "3000", "-o", text(&scene.file("b.glb"))]);
    within(8, &["bake", text(&scene.file("source.glb")), "-o", text(&scene.file("b.occ"))]);
    within(0, &["path", text(&scene.occ), "-o", text(&scene.file("b.csv"))]);
    let replay = ["replay", text(&scene.occ), "--backend", "cpu", "--out", text(&out)];
    let size = ["--size", "256x256", "--frames", "3"];
    within(4, &[&replay[..], &size, &["--pictures", "png"]].concat());
    // The mark and the table fit, not all of the rest.
    within(4, &[&replay[..], &size].concat());
    assert!(!out.join("summary.json").exists());
}

#[test]
fn two_bakes_of_one_scene_do_not_meet() {
    let plant = Plant::new(120_000);
    let mut first = occluster();
    first.args(plant.arguments()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut first = first.spawn().unwrap();
    let work = plant.folder.path().join(WORK);
    let deadline = Instant::now() + Duration::from_secs(60);
    while !work.join("meshes").exists() {
        assert!(Instant::now() < deadline, "it never began");
        std::thread::sleep(Duration::from_millis(2));
    }
    support::fail(&plant.arguments(), 75, "plant.occ");
    assert!(first.wait().unwrap().success());
    assert!(std::fs::read(&plant.occ).unwrap() == plant.whole);
    assert_eq!(names(plant.folder.path()), DONE);
}
