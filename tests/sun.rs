//! The sun stands where a run says, on every rig and backend, and where it stood before if nothing is said.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use support::{Run, Scene, backends, fail, succeed, text};

const FRAMES: usize = 6;

/// A scene, its walk, and what is replayed of it.
struct Place {
    scene: Scene,
    walk: std::path::PathBuf,
}

impl Place {
    fn new() -> Self {
        let scene = Scene::synth("plant", 60_000);
        let walk = scene.path("walk", FRAMES as u32);
        Self { scene, walk }
    }

    fn replay(&self, name: &str, options: &[&str]) -> Run {
        let mut all = vec!["--size", "120x80", "--path", text(&self.walk)];
        all.extend(options);
        self.scene.replay(name, &all)
    }
}

#[test]
fn a_moved_sun_changes_all_pictures_and_the_default_none() {
    let place = Place::new();
    let rig = place.scene.file("rig.toml");
    std::fs::write(&rig, "sun = [-1, 0.5, 0]\n").unwrap();
    for backend in backends() {
        let of = |name: &str, options: &[&str]| {
            let mut all = vec!["--backend", backend];
            all.extend(options);
            place.replay(&format!("{backend}-{name}"), &all)
        };
        let plain = of("plain", &[]);
        let same = of("same", &["--sun", "0.35,0.85,0.4", "--processes", "1"]);
        assert_eq!(same.hashes(), plain.hashes(), "{backend}: the default");
        let longer = of("longer", &["--sun", "2.8,6.8,3.2", "--processes", "1"]);
        assert_eq!(longer.hashes(), plain.hashes(), "{backend}: only its direction counts");

        let moved = of("moved", &["--sun", "-1,0.5,0", "--audit", "every=1"]);
        moved.assert_audited(backend);
        let pairs = moved.hashes().into_iter().zip(plain.hashes());
        assert_eq!(pairs.filter(|(a, b)| a != b).count(), FRAMES, "{backend}");
        let all = ["--schedule", "rotate", "--processes", "1", "--cull", "off"];
        let by_rig = of("rig", &[&["--rig", text(&rig)][..], &all].concat());
        assert_eq!(by_rig.hashes(), moved.hashes(), "{backend}: by the rig file");
        let by_flag = of("flag", &["--rig", text(&rig), "--sun", "0.35,0.85,0.4"]);
        assert_eq!(by_flag.hashes(), plain.hashes(), "{backend}: a flag goes before it");
    }
}

#[test]
fn a_sun_that_stands_nowhere_is_refused() {
    let place = Place::new();
    let occ = text(&place.scene.occ);
    for (sun, says) in [
        ("0,0,0", "is no direction: give three finite numbers, one of them not 0"),
        ("1,nan,0", "is no direction"),
        ("1,-inf,0", "is no direction"),
        ("1,2", "write X,Y,Z"),
        ("up", "write X,Y,Z"),
    ] {
        fail(&["replay", occ, "--sun", sun], 2, says);
    }
    let rig = place.scene.file("rig.toml");
    std::fs::write(&rig, "sun = [0, 0, 0]\n").unwrap();
    fail(&["replay", occ, "--rig", text(&rig)], 78, "is no direction");
}

#[test]
fn a_far_field_under_another_sun_is_refused_before_anything_is_drawn() {
    let place = Place::new();
    let occ = place.scene.file("far.occ");
    let mut bake = vec!["bake", text(&place.scene.occ), "-o", text(&occ), "--far", "tdm"];
    bake.extend(["--far-always", "--far-side", "64", "--cells-along", text(&place.walk)]);
    succeed(&bake);
    let relit = place.scene.file("relit.occ");
    bake[3] = text(&relit);
    succeed(&[&bake[..], &["--far-relight"]].concat());
    let out = place.scene.file("out");
    let mut replay = vec!["replay", text(&occ), "--path", text(&place.walk), "--size", "64x48"];
    replay.extend(["--backend", "cpu", "--out", text(&out)]);
    let with = |options: &[&'static str]| [&replay[..], options].concat();
    let moved = ["--sun", "0,1,0"];
    let far = [&moved[..], &["--far", "tdm"]].concat();
    fail(&with(&far), 78, "`bake --far-relight`");
    // With normals any sun will do.
    let mut of_relit = with(&far);
    of_relit[1] = text(&relit);
    succeed(&of_relit);
    // Its light is not asked for, or is the sun's own.
    succeed(&with(&[&moved[..], &["--far", "off"]].concat()));
    succeed(&with(&[&moved[..], &["--far", "itdm"]].concat()));
    succeed(&with(&["--sun", "0.7,1.7,0.8", "--far", "tdm"]));
}
