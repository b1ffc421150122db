//! Far fields: a view cell's cubes are baked the same every time, are drawn the same by every rig, keep
//! their budgets and the cap, and what is wrong with them is told.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

mod support;

use protocol::id::BlobId;
use scene::store::Store;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use support::{CPU, Run, Scene, backends, fail, occluster, succeed, text};

/// Poses in the cell that has a far field, and of the whole path.
const INSIDE: usize = 8;
const POSES: usize = 12;
/// Cubes of the cell.
const CUBES: u64 = 5;

/// A scene, and a path of which the first poses lie in a cell and the rest elsewhere.
struct Place {
    scene: Scene,
    plain: PathBuf,
    path: PathBuf,
    /// The path's poses that are given to the bake.
    along: PathBuf,
}

impl Place {
    fn new() -> Self {
        let scene = Scene::synth("plant", 100_000);
        let poses = |seed| {
            let csv = std::fs::read_to_string(scene.path_by_seed("walk", 240, seed)).unwrap();
            csv.lines().map(str::to_owned).collect::<Vec<_>>()
        };
        let (here, there) = (poses(1), poses(3));
        let inside = here[1..].iter().step_by(8).take(INSIDE);
        let outside = there[1..].iter().step_by(8).take(POSES - INSIDE);
        let write = |name: &str, lines: Vec<&String>| {
            let csv = scene.file(name);
            let lines: Vec<&str> = lines.into_iter().map(String::as_str).collect();
            std::fs::write(&csv, lines.join("\n") + "\n").unwrap();
            csv
        };
        let header = std::iter::once(&here[0]);
        let along = write("along.csv", header.clone().chain(inside.clone()).collect());
        let path = write("path.csv", header.chain(inside).chain(outside).collect());
        let plain = scene.occ.clone();
        Self { scene, plain, path, along }
    }

    /// The same with the far field of one cell.
    fn with(far: &str, side: &str) -> Self {
        let mut place = Self::new();
        let occ = place.scene.file(&format!("{far}.occ"));
        succeed(&place.bake(&place.plain, &occ, far, &["--far-side", side]));
        place.scene.occ = occ;
        place
    }

    /// The arguments that bake far fields.
    fn bake<'a>(
        &'a self,
        input: &'a Path,
        output: &'a Path,
        far: &'a str,
        options: &[&'a str],
    ) -> Vec<&'a str> {
        let mut all = vec!["bake", text(input), "-o", text(output), "--far", far];
        all.extend(["--far-samples", "5", "--far-cell-triangles", "10000"]);
        // So small a plant is cheaper as geometry.
        if !options.contains(&"--json") {
            all.push("--far-always");
        }
        if !options.contains(&"--cells-along") {
            all.extend(["--cells-along", text(&self.along)]);
        }
        all.extend(options);
        all
    }

    /// Replays the path through the scene with far fields.
    fn replay(&self, name: &str, options: &[&str]) -> Run {
        self.replay_of(&self.scene.occ, name, options)
    }

    /// Likewise through another file of the scene.
    fn replay_of(&self, occ: &Path, name: &str, options: &[&str]) -> Run {
        let out = self.scene.file(name);
        let mut all = vec!["replay", text(occ), "--out", text(&out)];
        all.extend(["--path", text(&self.path), "--size", "161x97"]);
        if !options.contains(&"--backend") {
            all.extend(["--backend", CPU]);
        }
        all.extend(options);
        succeed(&all);
        Run::read(&out)
    }
}

fn inspect(occ: &Path) -> Value {
    serde_json::from_slice(&succeed(&["inspect", text(occ), "--json"]).stdout).unwrap()
}

fn number(value: &Value, pointer: &str) -> u64 {
    value.pointer(pointer).and_then(Value::as_u64).unwrap_or_else(|| panic!("no {pointer}"))
}

/// Triangles of cubes, by frame.
fn far(run: &Run) -> Vec<u64> {
    run.column("triangles_far").into_iter().map(|count| count.parse().unwrap()).collect()
}

/// Mean square difference of the pictures of poses in the cell, in 8-bit steps.
fn difference(a: &Run, b: &Run) -> f64 {
    let pictures = |run: &Run| {
        let mut files: Vec<PathBuf> =
            std::fs::read_dir(run.out.join("frames")).unwrap().map(|e| e.unwrap().path()).collect();
        files.sort();
        assert_eq!(files.len(), POSES);
        let pixels = |file: &PathBuf| image::open(file).unwrap().to_rgb8().into_raw();
        files[..INSIDE].iter().flat_map(pixels).collect::<Vec<u8>>()
    };
    let (a, b) = (pictures(a), pictures(b));
    assert_eq!(a.len(), b.len());
    let squares = a.iter().zip(&b).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    squares.sum::<f64>() / a.len() as f64
}

/// Names in a folder.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// What must hold of every method; `cubes` is how many its cell has.
fn every_rig_draws_the_same(method: &str, cubes: u64) {
    let place = Place::with(method, "128");
    succeed(&["verify", text(&place.scene.occ)]);
    let inspected = inspect(&place.scene.occ);
    let count = |name: &str| number(&inspected, &format!("/far_fields/{name}"));
    assert_eq!((count(method), count("cubes"), count("delta_cubes")), (1, cubes, cubes - 1));
    assert_eq!(count("none") + count("tdm") + count("itdm"), 1);
    assert!(count("triangles") > 0 && number(&inspected, "/bytes/faces") > 0);

    let geometry = place.replay("off", &["--far", "off"]);
    let plain = place.replay_of(&place.plain, "plain", &[]);
    assert_eq!(geometry.hashes(), plain.hashes(), "{method}: off is the scene without far fields");
    let other = if method == "tdm" { "itdm" } else { "tdm" };
    let other = place.replay("other", &["--far", other]);
    assert_eq!(other.hashes(), plain.hashes(), "{method}: no cell has the other one");

    for backend in backends() {
        let of = |name: &str, options: &[&str]| {
            let name = format!("{backend}-{name}");
            let mut all = vec!["--backend", backend, "--far", method];
            all.extend(options);
            place.replay(&name, &all)
        };
        let three = of("three", &["--audit", "every=1", "--processes", "3"]);
        three.assert_audited(&format!("{backend} {method}"));
        let expected = three.hashes();
        let far = far(&three);
        assert!(far[..INSIDE].iter().all(|count| *count > 0), "{far:?}");
        assert!(far[INSIDE..].iter().all(|count| *count == 0), "{far:?}");
        assert!(far.iter().all(|far| *far <= count("triangles")), "{far:?}");
        if backend == CPU {
            let shown = geometry.hashes();
            assert!(expected[..INSIDE].iter().zip(&shown).all(|(a, b)| a != b), "nothing changed");
            assert_eq!(expected[INSIDE..], shown[INSIDE..], "outside of the cell");
            for (name, options) in [
                ("again", &[][..]),
                ("one", &["--processes", "1"]),
                ("rotate", &["--schedule", "rotate"]),
                ("boxes", &["--cull", "boxes"]),
                ("uncut", &["--cull", "off"]),
                ("rotate-one", &["--schedule", "rotate", "--processes", "1", "--cull", "boxes"]),
            ] {
                assert_eq!(of(name, options).hashes(), expected, "{backend} {method} {name}");
            }
        } else {
            let all = ["--schedule", "rotate", "--processes", "1", "--cull", "boxes"];
            assert_eq!(of("rotate", &all).hashes(), expected, "{backend} {method}");
        }
    }
}

#[test]
fn every_rig_draws_the_same_cubes() {
    every_rig_draws_the_same("itdm", CUBES);
}

#[test]
fn every_rig_draws_the_same_depth_mesh() {
    every_rig_draws_the_same("tdm", 1);
}

#[test]
fn cubes_with_normals_follow_the_sun_on_every_rig() {
    let mut place = Place::new();
    let [bare, relit] = ["bare.occ", "relit.occ"].map(|name| place.scene.file(name));
    let side = ["--far-side", "128"];
    succeed(&place.bake(&place.plain, &bare, "itdm", &side));
    succeed(&place.bake(&place.plain, &relit, "itdm", &[&side[..], &["--far-relight"]].concat()));
    succeed(&["verify", text(&relit)]);
    let faces = |occ: &Path| number(&inspect(occ), "/bytes/faces");
    let (without, with) = (faces(&bare), faces(&relit));
    eprintln!("{without} bytes of faces without normals, {with} with");
    assert!(with > without && with < 2 * without, "{without} {with}");

    place.scene.occ = relit;
    let moved = ["--sun", "-0.8,0.5,0.2"];
    for backend in backends() {
        let of = |occ: &Path, name: &str, options: &[&str]| {
            let mut all = vec!["--backend", backend, "--pictures", "png"];
            all.extend(options);
            place.replay_of(occ, &format!("{backend}-{name}"), &all)
        };
        let far = ["--far", "itdm"];
        let stored = of(&bare, "bare", &far);
        let same = of(&place.scene.occ, "same", &far);
        assert_eq!(same.hashes(), stored.hashes(), "{backend}: normals show under the bake's sun");

        let far = [&moved[..], &far].concat();
        let three = of(&place.scene.occ, "three", &[&far[..], &["--audit", "every=1"]].concat());
        three.assert_audited(backend);
        let one = ["--schedule", "rotate", "--processes", "1", "--cull", "boxes"];
        let one = of(&place.scene.occ, "one", &[&far[..], &one].concat());
        assert_eq!(one.hashes(), three.hashes(), "{backend}");

        let geometry = ["--far", "off", "--lod", "0", "--processes", "1"];
        let truth = of(&place.plain, "truth", &geometry);
        let moved_truth = of(&place.plain, "moved", &[&moved[..], &geometry].concat());
        let [as_baked, relit, stale] =
            [(&stored, &truth), (&three, &moved_truth), (&stored, &moved_truth)]
                .map(|(found, truth)| difference(found, truth));
        eprintln!(
            "{backend}: square error {as_baked:.1} as baked, {relit:.1} relit, {stale:.1} stale"
        );
        assert!(relit < 1.2 * as_baked + 2.0 && stale > 2.0 * relit, "{as_baked} {relit} {stale}");
    }
}

#[test]
fn more_cubes_cost_more_and_are_not_worse_and_budgets_are_kept() {
    let place = Place::with("itdm", "128");
    let of = |name: &str, options: &[&str]| {
        let mut all = vec!["--processes", "1", "--pictures", "png"];
        all.extend(options);
        place.replay(name, &all)
    };
    let truth = of("truth", &["--far", "off", "--lod", "0"]);
    let cubes = |count: &str| of(count, &["--far", "itdm", "--far-cubes", count]);
    let runs = ["1", "2", "5"].map(cubes);
    for pair in runs.windows(2) {
        let (fewer, more) = (far(&pair[0]), far(&pair[1]));
        assert!(fewer.iter().zip(&more).all(|(fewer, more)| fewer <= more), "{fewer:?} {more:?}");
    }
    let [one, _, all] = &runs;
    let (worst, best) = (difference(one, &truth), difference(all, &truth));
    eprintln!("mean square error with 1 cube {worst:.2}, with {CUBES} {best:.2}");
    // A hundredth for what lies on two cubes.
    assert!(worst > 0.0 && best <= worst * 1.01, "1 cube {worst}, {CUBES} cubes {best}");

    let (one, all) = (far(one), far(all));
    let most = (one[0] + all[0]) / 2;
    let limited = far(&of("limited", &["--far", "itdm", "--far-triangles", &most.to_string()]));
    for (frame, count) in limited.iter().enumerate() {
        assert!(*count <= most || *count == one[frame], "frame {frame}: {count} of {most}");
    }
    assert!(limited[0] < all[0] && limited[0] >= one[0], "{limited:?}");
    let single = far(&of("single", &["--far", "itdm", "--far-triangles", "1"]));
    assert_eq!(single, one, "one cube is always there");
}

/// Root of the mean squared change of a channel from a frame to the next.
fn change(run: &Run, frame: usize) -> f64 {
    let (a, b) = (run.picture(frame).into_raw(), run.picture(frame + 1).into_raw());
    let squares = a.iter().zip(&b).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    (squares.sum::<f64>() / a.len() as f64).sqrt()
}

/// A place whose path goes from one cell with a far field to another: first pairs of eyes a millionth of a cell apart,
/// on the border and where the margins end, then steps across.
fn border() -> Place {
    let mut place = Place::with("itdm", "128");
    let store = Store::open(&place.scene.occ).unwrap();
    let cell = store.skeleton().view_cells[0];
    let csv = std::fs::read_to_string(&place.along).unwrap();
    let mut lines = csv.lines();
    let header = lines.next().unwrap();
    let pose: Vec<f64> = lines.next().unwrap().split(',').map(|n| n.parse().unwrap()).collect();
    // Through a side that another cell lies behind.
    let side = cell.max[0] - cell.min[0];
    let is_last = cell.max[0] >= store.skeleton().hlods[0].max[0];
    let (border, outwards) = if is_last { (cell.min[0], -side) } else { (cell.max[0], side) };
    let ends = [0.0, -1.0, 1.0].map(|share| share * f64::from(cell.margin));
    let pairs = ends.iter().flat_map(|&at| [at - 5e-7, at + 5e-7]);
    let steps = (-10..=10).map(|at| f64::from(at) / 200.0);
    let through = |at: f64| {
        let mut pose = pose.clone();
        pose[0] = border + at * outwards;
        (pose[3], pose[4], pose[5]) = (pose[0] + 0.6, pose[1], pose[2] - 0.8);
        pose.iter().map(f64::to_string).collect::<Vec<_>>().join(",")
    };
    let lines: Vec<String> = pairs.chain(steps).map(through).collect();
    std::fs::write(&place.path, format!("{header}\n{}\n", lines.join("\n"))).unwrap();
    place.along.clone_from(&place.path);
    place
}

#[test]
fn from_cell_to_cell_no_picture_jumps() {
    let mut place = border();
    let both = place.scene.file("both.occ");
    succeed(&place.bake(&place.plain, &both, "itdm", &["--far-side", "128"]));
    assert_eq!(number(&inspect(&both), "/far_fields/itdm"), 2);
    place.scene.occ = both;

    for backend in backends() {
        let of = |name: &str, options: &[&str]| {
            let mut all = vec!["--backend", backend, "--far", "itdm"];
            all.extend(options);
            place.replay(&format!("{backend}-{name}"), &all)
        };
        let mixed = of("mixed", &["--audit", "every=1", "--pictures", "png"]);
        mixed.assert_audited(backend);
        let uncut = of("uncut", &["--cull", "off", "--processes", "1", "--schedule", "rotate"]);
        assert_eq!(uncut.hashes(), mixed.hashes(), "{backend}");
        let jumps = [0, 2, 4].map(|frame| change(&mixed, frame));
        assert!(jumps.iter().all(|&jump| jump < 0.5), "{backend}: {jumps:?} steps of a channel");
        assert!((6..26).all(|frame| change(&mixed, frame) > 0.5), "{backend}: nothing to be seen");
        if backend == CPU {
            let most = far(&mixed)[0] * 2 / 3;
            let few = of("few", &["--far-triangles", &most.to_string()]);
            let one = far(&of("one", &["--far-cubes", "1"]));
            for (frame, count) in far(&few).into_iter().enumerate() {
                assert!(count <= most.max(one[frame]), "frame {frame}: {count} of {most}");
            }
            assert!(far(&few)[0] < far(&mixed)[0]);
        }
        // On the border both cells' cubes are drawn.
        let far = far(&mixed);
        assert!(far[0] > far[2].max(far[5]) && far[2].min(far[5]) > 0, "{backend}: {far:?}");
    }
}

#[test]
fn under_a_cap_the_pictures_are_the_same_and_nothing_late_is_waited_for() {
    let place = Place::with("itdm", "128");
    let inspected = inspect(&place.scene.occ);
    let bytes = ["vertices", "indices", "faces"];
    let all: u64 = bytes.iter().map(|kind| number(&inspected, &format!("/bytes/{kind}"))).sum();
    let skeleton = protocol::format::read_skeleton(&place.scene.occ).unwrap().skeleton;
    let cap = skeleton.resident_bytes() + all / 4;
    let memory = cap.to_string();
    let of = |name: &str, options: &[&str]| {
        let mut all = vec!["--far", "itdm"];
        all.extend(options);
        place.replay(name, &all)
    };
    let assert_within = |run: &Run| {
        let peaks = run.summary["memory"]["peak_resident"].as_array().unwrap().iter();
        let peaks: Vec<u64> = peaks.map(|peak| peak.as_u64().unwrap()).collect();
        assert!(peaks.iter().all(|peak| *peak <= cap), "{peaks:?} of {cap} bytes");
    };
    let whole = of("whole", &[]);
    for prefetch in ["on", "off"] {
        let run = of(prefetch, &["--memory", &memory, "--prefetch", prefetch]);
        assert_eq!(run.hashes(), whole.hashes(), "prefetch {prefetch}");
        assert_eq!((far(&run), run.number("/stand_ins/frames")), (far(&whole), 0.0));
        assert_within(&run);
    }
    let late = of("late", &["--memory", &memory, "--residency", "deadline"]);
    assert_within(&late);
    assert_eq!(late.rows.len(), POSES);
    assert_eq!(late.number("/io/waits"), 0.0, "{}", late.summary["io"]);
    let (replaced, holes) = (late.column("replaced"), late.column("holes"));
    for (frame, (shown, truth)) in late.hashes().iter().zip(whole.hashes()).enumerate() {
        let is_whole = (replaced[frame], holes[frame]) == ("0", "0");
        assert!(!is_whole || *shown == truth, "frame {frame} is not marked and is not exact");
    }
}

#[test]
fn a_bake_gives_the_same_bytes_and_replaces_what_was_there() {
    let place = Place::new();
    let bake = |input: &Path, output: &str, options: &[&str]| {
        let output = place.scene.file(output);
        let mut all = vec!["--far-side", "64"];
        all.extend(options);
        succeed(&place.bake(input, &output, "itdm", &all));
        output
    };
    let one = bake(&place.plain, "one.occ", &["--jobs", "1"]);
    let two = bake(&place.plain, "two.occ", &["--jobs", "2"]);
    let at_once = bake(&place.scene.file("source.glb"), "at_once.occ", &[]);
    let read = |occ: &Path| std::fs::read(occ).unwrap();
    assert!(read(&one) == read(&two), "the number of threads shows");
    assert!(read(&one) == read(&at_once), "in one go or in two");
    // Once more: the key has changed, and it alone.
    let again = bake(&one, "again.occ", &[]);
    let (first, second) = (Store::open(&one).unwrap(), Store::open(&again).unwrap());
    let mut expected = first.skeleton().as_ref().clone();
    assert_ne!(expected.info.key, second.skeleton().info.key);
    expected.info.key = second.skeleton().info.key;
    assert!(expected == **second.skeleton(), "something else than the key changed");
    assert_eq!(inspect(&one), inspect(&again));
    succeed(&["verify", text(&again)]);
    // Another method takes the place of the first.
    let tdm = place.scene.file("tdm.occ");
    succeed(&place.bake(&again, &tdm, "tdm", &["--far-side", "64"]));
    let inspected = inspect(&tdm);
    let count = |name: &str| number(&inspected, &format!("/far_fields/{name}"));
    assert_eq!((count("itdm"), count("tdm"), count("cubes")), (0, 1, 1));
    let faces = Store::open(&tdm).unwrap().skeleton().cubes[0].blobs().count() as u64;
    assert_eq!(number(&inspected, "/blobs") - number(&inspect(&place.plain), "/blobs"), faces);
}

#[test]
fn a_bake_that_was_cut_short_goes_on_and_none_meets_another() {
    let place = border();
    let folder = place.plain.parent().unwrap();
    let whole = place.scene.file("whole.occ");
    succeed(&place.bake(&place.plain, &whole, "itdm", &["--far-side", "128"]));
    let before = names(folder);
    let output = place.scene.file("cut.occ");
    let arguments = place.bake(&place.plain, &output, "itdm", &["--far-side", "128"]);
    let work = folder.join(".cut.occ.far");
    let kept = work.join("cell-0");
    for signal in ["INT", "KILL"] {
        let mut bake = occluster();
        bake.args(&arguments).stdout(Stdio::null()).stderr(Stdio::piped());
        let bake = bake.spawn().unwrap();
        let deadline = Instant::now() + Duration::from_secs(60);
        while !kept.exists() {
            assert!(Instant::now() < deadline, "no cell was ever kept");
            std::thread::sleep(Duration::from_millis(2));
        }
        if signal == "INT" {
            fail(&arguments, 75, "another bake is writing this scene");
        } else {
            // It goes on with the second cell, which takes longer.
            std::thread::sleep(Duration::from_millis(100));
        }
        let kill = format!("kill -{signal} {}", bake.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        let bake = bake.wait_with_output().unwrap();
        let says = String::from_utf8(bake.stderr).unwrap();
        if signal == "INT" {
            assert_eq!(bake.status.code(), Some(1), "{says}");
            assert!(says.contains(".cut.occ.far") && says.contains("goes on"), "{says}");
            assert_eq!(names(&work), ["cell-0", "lock"], "no more than what is finished");
        }
        assert!(kept.exists() && !output.exists(), "{signal}: {says}");
    }
    // The time that the first cell took is told by the one who took it.
    let told = std::fs::read(&kept).unwrap();
    let arguments = [&arguments[..], &["--json"]].concat();
    let summary: Value = serde_json::from_slice(&succeed(&arguments).stdout).unwrap();
    let seconds = summary["cells"][0]["seconds"][2].as_f64().unwrap();
    let number = |bytes: &[u8]| f64::from_le_bytes(bytes.try_into().unwrap());
    assert!(told.windows(8).any(|at| (number(at) - seconds).abs() < 1e-12 * seconds), "made again");
    assert!(std::fs::read(&output).unwrap() == std::fs::read(&whole).unwrap(), "other bytes");
    std::fs::remove_file(&output).unwrap();
    assert_eq!(names(folder), before, "something is left behind");
}

#[test]
fn a_cell_that_is_cheaper_as_geometry_gets_no_cubes_and_says_so() {
    let place = Place::new();
    let occ = place.scene.file("far.occ");
    let output = succeed(&place.bake(&place.plain, &occ, "itdm", &["--far-side", "512", "--json"]));
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let cell = &summary["cells"][0];
    let triangles = |key: &str| cell[key].as_u64().unwrap();
    assert!(triangles("cubes_in_view") >= triangles("geometry_in_view"), "{cell}");
    assert_eq!(cell["kept"], false);
    succeed(&["verify", text(&occ)]);
    let inspected = succeed(&["inspect", text(&occ), "--json"]);
    let inspected: Value = serde_json::from_slice(&inspected.stdout).unwrap();
    assert_eq!(inspected["far_fields"]["none"], 1);
    assert_eq!(inspected["far_fields"]["cubes"], 0);
}

#[test]
fn what_cannot_be_baked_is_refused_and_leaves_nothing() {
    let place = Place::new();
    let folder = place.plain.parent().unwrap();
    let output = place.scene.file("out.occ");
    let refused = |input: &Path, options: &[&str], code: i32, says: &str| {
        let before = names(folder);
        fail(&place.bake(input, &output, "itdm", options), code, says);
        assert_eq!(names(folder), before, "{says}");
    };
    let source = place.scene.file("source.glb");
    for input in [&place.plain, &source] {
        refused(input, &["--far-side", "100"], 2, "--far-side 100: give a power of two");
    }
    let outside = place.scene.file("outside.csv");
    let csv = std::fs::read_to_string(&place.along).unwrap();
    let header = csv.lines().next().unwrap();
    std::fs::write(&outside, format!("{header}\n9e6,9e6,9e6,0,0,0,0,1,0,60\n")).unwrap();
    let along = ["--far-side", "16", "--cells-along", text(&outside)];
    refused(&place.plain, &along, 65, "scene.occ: none of the viewpoints lies inside");
    refused(&source, &along, 65, "none of the viewpoints lies inside");
    refused(&place.scene.file("absent.occ"), &[], 66, "absent.occ");
    let along = place.scene.file("absent.csv");
    for input in [&place.plain, &source] {
        refused(input, &["--cells-along", text(&along)], 66, "absent.csv");
    }
    refused(&place.scene.file("absent.glb"), &[], 66, "absent.glb");
    let foreign = place.scene.file("foreign.occ");
    std::fs::write(&foreign, "no scene at all").unwrap();
    refused(&foreign, &[], 65, "foreign.occ");
    // A scene without cells is drawn as ever.
    let off = place.replay("off", &["--far", "off"]);
    let far_field = place.replay("itdm", &["--far", "itdm"]);
    assert_eq!(off.hashes(), far_field.hashes());
    assert!(far(&far_field).iter().all(|count| *count == 0));
}

#[test]
fn a_damaged_face_is_named_and_all_frames_are_shown() {
    let place = Place::with("itdm", "64");
    let store = Store::open(&place.scene.occ).unwrap();
    // The largest face of the intra cube is in every picture from the cell that looks its way.
    let faces = store.skeleton().cubes[0].blobs();
    let blob = faces.max_by_key(|blob| store.skeleton().blob(BlobId(*blob)).bytes).unwrap();
    let content = store.load_blob(BlobId(blob)).unwrap();
    let mut file = std::fs::read(&place.scene.occ).unwrap();
    let at = file.windows(content.len()).position(|bytes| bytes == &content[..]).unwrap();
    file[at + content.len() / 2] ^= 0x10;
    let damaged = place.scene.file("damaged.occ");
    std::fs::write(&damaged, file).unwrap();
    fail(&["verify", text(&damaged)], 65, &format!("damaged.occ: blob {blob} is damaged"));
    let whole = place.replay("whole", &["--far", "itdm"]);
    for residency in ["exact", "deadline"] {
        let out = place.scene.file(residency);
        let mut options = vec!["replay", text(&damaged), "--path", text(&place.path)];
        options.extend(["--size", "161x97", "--backend", CPU, "--far", "itdm"]);
        options.extend(["--residency", residency, "--out", text(&out)]);
        let output = occluster().args(&options).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(65), "{said}");
        assert!(said.contains(&format!("damaged.occ: blob {blob} is damaged")), "{said}");
        let run = Run::read(&out);
        assert_eq!(run.rows.len(), POSES, "all frames are shown");
        assert!(run.number("/io/faults") > 0.0 && run.number("/stand_ins/holes") > 0.0);
        if residency == "exact" {
            assert!(far(&run).iter().zip(far(&whole)).all(|(left, all)| *left <= all));
            assert_eq!(run.hashes()[INSIDE..], whole.hashes()[INSIDE..], "outside of the cell");
        }
    }
}
