//! A bake that was cut short goes on, and what it writes in the end does not show it.

use super::*;
use crate::synth::{self, Kind};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;

/// Small blocks: many checkpoints from little geometry.
fn options(jobs: usize) -> Options {
    Options {
        jobs,
        memory: 16 << 20,
        piece_triangles: 500,
        hlod_triangles: 500,
        ..Options::default()
    }
}

/// So many threads make blocks of so few triangles that there are several of them.
const MANY: usize = 16;

struct Yard {
    folder: tempfile::TempDir,
}

impl Yard {
    /// With `pipes.glb`, which has instances, and `plant.glb`.
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (kind, name) in [(Kind::Pipes, "pipes.glb"), (Kind::Plant, "plant.glb")] {
            let model = synth::generate(kind, Some(5_000), 1);
            synth::write_glb(&model, &folder.path().join(name)).unwrap();
        }
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn bake(&self, input: &str, options: &Options, progress: &dyn Progress) -> Summary {
        bake(&[self.path(input)], &self.path("scene.occ"), options, progress).unwrap()
    }

    /// Bytes of the scene, which is taken away; beside the inputs nothing may be left.
    fn take(&self) -> Vec<u8> {
        assert_eq!(names(self.folder.path()), ["pipes.glb", "plant.glb", "scene.occ"]);
        let bytes = std::fs::read(self.path("scene.occ")).unwrap();
        std::fs::remove_file(self.path("scene.occ")).unwrap();
        bytes
    }

    /// What a bake that nothing disturbs writes.
    fn undisturbed(&self, input: &str, options: &Options) -> Vec<u8> {
        self.bake(input, options, &Silent);
        self.take()
    }

    /// Puts a working folder back.
    fn restore(&self, kept: &Kept) {
        let work = self.path(".scene.occ.bake");
        std::fs::create_dir(&work).unwrap();
        for (name, bytes) in kept {
            std::fs::write(work.join(name), bytes).unwrap();
        }
    }

    /// Bakes to the end, and leaves the working folders that a kill would have left on the way.
    fn kills(&self, input: &str, options: &Options) -> Vec<(String, Kept)> {
        let copies = Copies {
            work: self.path(".scene.occ.bake"),
            stage: Mutex::default(),
            seen: Mutex::default(),
        };
        self.bake(input, options, &copies);
        self.take();
        copies.seen.into_inner().unwrap()
    }
}

/// Files of a working folder.
type Kept = Vec<(String, Vec<u8>)>;

/// Copies the working folder at every call.
struct Copies {
    work: PathBuf,
    stage: Mutex<String>,
    seen: Mutex<Vec<(String, Kept)>>,
}

impl Copies {
    fn copy(&self) {
        let read = |name: String| {
            let bytes = std::fs::read(self.work.join(&name)).unwrap();
            (name, bytes)
        };
        let mut seen = self.seen.lock().unwrap();
        let files = names(&self.work).into_iter().map(read).collect();
        seen.push((self.stage.lock().unwrap().clone(), files));
    }
}

impl Progress for Copies {
    fn stage(&self, name: &str, _total: u64) {
        name.clone_into(&mut self.stage.lock().unwrap());
        self.copy();
    }
    fn advance(&self, _steps: u64) {
        // Meshes are divided by many threads: one of them may be writing.
        if *self.stage.lock().unwrap() != "partition" {
            self.copy();
        }
    }
    fn finish(&self) {}
}

/// Notes which stages did something.
#[derive(Default)]
struct Steps(Mutex<Vec<(String, u64)>>);

impl Progress for Steps {
    fn stage(&self, name: &str, _total: u64) {
        self.0.lock().unwrap().push((name.to_owned(), 0));
    }
    fn advance(&self, steps: u64) {
        self.0.lock().unwrap().last_mut().unwrap().1 += steps;
    }
    fn finish(&self) {}
}

impl Steps {
    fn of(self, stage: &str) -> u64 {
        let stages = self.0.into_inner().unwrap();
        stages.iter().filter(|(name, _)| name == stage).map(|(_, steps)| steps).sum()
    }
}

/// Dies in a stage, after some steps.
struct Dies(&'static str, Mutex<(bool, u64)>);

impl Progress for Dies {
    fn stage(&self, name: &str, _total: u64) {
        self.1.lock().unwrap().0 = name == self.0;
    }
    fn advance(&self, _steps: u64) {
        let mut state = self.1.lock().unwrap();
        let (is_there, left) = *state;
        assert!(!is_there || left > 0, "the test ends this bake here");
        state.1 -= u64::from(is_there);
    }
    fn finish(&self) {}
}

/// Ends a bake in `stage` after so many steps.
fn cut(yard: &Yard, input: &str, options: &Options, stage: &'static str, steps: u64) {
    let dies = Dies(stage, Mutex::new((false, steps)));
    let ended = catch_unwind(AssertUnwindSafe(|| yard.bake(input, options, &dies)));
    assert!(ended.is_err(), "{stage} has no more than {steps} steps");
    assert!(!yard.path("scene.occ").exists());
}

#[test]
fn the_bytes_depend_on_neither_threads_nor_memory() {
    let yard = Yard::new();
    for input in ["pipes.glb", "plant.glb"] {
        let first = yard.undisturbed(input, &options(1));
        for (jobs, memory) in [(2, 16 << 20), (5, 16 << 20), (MANY, 16 << 20), (2, 1 << 30)] {
            let bytes = yard.undisturbed(input, &Options { memory, ..options(jobs) });
            assert!(bytes == first, "{input} with {jobs} threads and {memory} bytes differs");
        }
    }
}

#[test]
fn a_killed_bake_goes_on_with_other_threads_and_memory_to_the_same_bytes() {
    let yard = Yard::new();
    let whole = yard.undisturbed("pipes.glb", &options(1));
    let kills = yard.kills("pipes.glb", &options(MANY));
    let in_levels = kills.iter().filter(|(stage, _)| stage == "levels").count();
    assert!(in_levels >= 4, "{in_levels}");
    let step = kills.len().div_ceil(7);
    for (n, (stage, kept)) in kills.iter().enumerate().skip(1).step_by(step) {
        yard.restore(kept);
        let (jobs, memory) = [(MANY, 16 << 20), (1, 16 << 20), (3, 1 << 30)][n / step % 3];
        yard.bake("pipes.glb", &Options { memory, ..options(jobs) }, &Silent);
        assert!(yard.take() == whole, "killed in {stage}, {n}");
    }
}

#[test]
fn files_that_are_too_short_cost_time_and_not_the_scene() {
    let yard = Yard::new();
    let whole = yard.undisturbed("pipes.glb", &options(1));
    let (_, kept) = yard.kills("pipes.glb", &options(MANY)).pop().unwrap();
    let files: Vec<&str> = kept.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(files, ["import", "journal", "lock", "partition", "pieces", "scene", "shared"]);
    for name in files {
        let length = kept.iter().find(|(file, _)| file == name).unwrap().1.len();
        let many = if name == "journal" || name == "scene" { 5 } else { 2 };
        for n in 0..many {
            let end = n * length / many + n % 2;
            let mut torn = kept.clone();
            torn.iter_mut().filter(|(file, _)| file == name).for_each(|(_, b)| b.truncate(end));
            yard.restore(&torn);
            yard.bake("pipes.glb", &options(3), &Silent);
            assert!(yard.take() == whole, "{name} cut to {end} of {length}");
        }
    }
}

#[test]
fn flipped_bits_are_noticed() {
    let yard = Yard::new();
    let whole = yard.undisturbed("pipes.glb", &options(1));
    let mut kills = yard.kills("pipes.glb", &options(MANY));
    let (_, late) = kills.pop().unwrap();
    let (_, early) = kills.into_iter().rfind(|(stage, _)| stage == "partition").unwrap();
    let files = ["journal", "scene", "partition", "pieces", "shared", "import"];
    let late = files.map(|name| (name, &late));
    for (name, kept) in late.into_iter().chain([("meshes", &early), ("import", &early)]) {
        const PLACES: usize = 6;
        for place in 0..PLACES {
            let mut torn = kept.clone();
            let bytes = &mut torn.iter_mut().find(|(file, _)| file == name).unwrap().1;
            let at = (bytes.len() - 1) * place / (PLACES - 1);
            bytes[at] ^= 1 << place;
            yard.restore(&torn);
            yard.bake("pipes.glb", &options(3), &Silent);
            assert!(yard.take() == whole, "{name} at {at}");
        }
    }
}

#[test]
fn stages_that_are_finished_are_not_done_again() {
    let yard = Yard::new();
    let steps = |change: fn(&mut Options)| {
        cut(&yard, "plant.glb", &options(MANY), "levels", 2);
        let mut changed = options(MANY);
        change(&mut changed);
        let steps = Steps::default();
        yard.bake("plant.glb", &changed, &steps);
        let resumed = yard.take();
        assert!(resumed == yard.undisturbed("plant.glb", &changed));
        let stages = steps.0.lock().unwrap().clone();
        let of = |name: &str| -> u64 {
            stages.iter().filter(|(stage, _)| stage == name).map(|(_, steps)| steps).sum()
        };
        [of("import"), of("partition"), of("levels")]
    };
    let all = Steps::default();
    yard.bake("plant.glb", &options(MANY), &all);
    yard.take();
    let all = all.of("levels");
    let [import, partition, levels] = steps(|_| {});
    assert_eq!([import, partition], [0, 0]);
    assert!(0 < levels && levels < all, "{levels} of {all}");
    assert_eq!(steps(|options| options.hlod_levels += 1), [0, 0, all]);
    let [_, partition, _] = steps(|options| options.piece_triangles += 50);
    assert!(partition > 0);
    let [import, ..] = steps(|options| options.texture_side = 256);
    assert_eq!(import, 1);
}

#[test]
fn another_input_is_never_taken_for_the_first() {
    let yard = Yard::new();
    let whole = yard.undisturbed("plant.glb", &options(2));
    // The first bake has its import on record, the second has just overwritten the meshes: once with
    // fewer bytes, once with more.
    for [first, second] in [["plant.glb", "pipes.glb"], ["pipes.glb", "plant.glb"]] {
        let whole = yard.undisturbed(first, &options(2));
        cut(&yard, first, &options(2), "partition", 1);
        cut(&yard, second, &options(2), "import", 0);
        yard.bake(first, &options(2), &Silent);
        assert!(yard.take() == whole, "{first}");
    }
    cut(&yard, "plant.glb", &options(2), "levels", 1);
    cut(&yard, "pipes.glb", &options(2), "levels", 1);
    yard.bake("plant.glb", &options(2), &Silent);
    assert!(yard.take() == whole);
    // The same name with other contents.
    cut(&yard, "plant.glb", &options(2), "levels", 1);
    std::fs::rename(yard.path("plant.glb"), yard.path("away")).unwrap();
    std::fs::copy(yard.path("pipes.glb"), yard.path("plant.glb")).unwrap();
    yard.bake("plant.glb", &options(2), &Silent);
    let other = std::fs::read(yard.path("scene.occ")).unwrap();
    assert!(other != whole);
}

#[test]
fn an_unchanged_scene_is_left_alone() {
    let yard = Yard::new();
    let first = yard.bake("pipes.glb", &options(2), &Silent);
    assert!(!first.unchanged);
    let path = yard.path("scene.occ");
    let written = || std::fs::metadata(&path).unwrap().modified().unwrap();
    let before = written();
    let steps = Steps::default();
    let again = yard.bake("pipes.glb", &Options { memory: 1 << 30, ..options(5) }, &steps);
    assert!(again.unchanged && again.to_string().contains("nothing has changed"));
    assert_eq!(
        (again.digest, again.hlods, again.levels),
        (first.digest, first.hlods, first.levels)
    );
    assert_eq!(steps.0.into_inner().unwrap(), []);
    assert_eq!(written(), before);
    assert!(!yard.bake("pipes.glb", &Options { seed: 1, ..options(2) }, &Silent).unchanged);
    assert!(!yard.bake("plant.glb", &Options { seed: 1, ..options(2) }, &Silent).unchanged);
    yard.take();
}

#[test]
fn one_bake_at_a_time_writes_a_scene() {
    let yard = Yard::new();
    let path = yard.path("scene.occ");
    let first = Work::open(&path).unwrap();
    let error = bake(&[yard.path("pipes.glb")], &path, &options(2), &Silent).unwrap_err();
    assert_eq!(error.exit_code(), 75);
    assert!(error.to_string().contains("scene.occ"), "{error}");
    drop(first);
    yard.bake("pipes.glb", &options(2), &Silent);
    yard.take();
}

#[test]
fn a_mesh_that_does_not_fit_the_memory_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    // 28 bytes a vertex and 24 for its two triangles, three times over: above 16 MiB.
    let scene = once(vec![triangle(2.0), terrain(340), tube(30, 20, 9.0)]);
    let bytes = [16 << 20, 1 << 30].map(|memory| {
        bake_source(&scene, &path, &Options { memory, ..Options::default() }).unwrap();
        std::fs::read(&path).unwrap()
    });
    assert!(bytes[0] == bytes[1]);
    assert_eq!(names(folder.path()), ["scene.occ"]);
}
