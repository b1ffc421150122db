//! Processes: whatever ends a run, all of them end; strangers get nothing.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]
#![cfg(target_os = "linux")]

mod support;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use support::{Scene, occluster, text};

/// A long replay in the background, and its three children once they run.
struct LongRun {
    coordinator: Child,
    nodes: Vec<u32>,
}

impl LongRun {
    fn start(scene: &Scene, extra: &[&str]) -> Self {
        let walk = scene.path("walk", 2000);
        let mut command = occluster();
        command
            .args(["replay", text(&scene.occ), "--path", text(&walk), "--backend", "cpu"])
            .args(extra);
        let coordinator = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let deadline = Instant::now() + Duration::from_secs(60);
        let mut nodes = children(coordinator.id());
        while nodes.len() < 3 {
            assert!(Instant::now() < deadline, "three children never started");
            std::thread::sleep(Duration::from_millis(20));
            nodes = children(coordinator.id());
        }
        std::thread::sleep(Duration::from_millis(500));
        Self { coordinator, nodes }
    }

    /// Waits for the coordinator: its code and what it said.
    fn end(mut self) -> (Option<i32>, String) {
        let deadline = Instant::now() + Duration::from_secs(30);
        while self.coordinator.try_wait().unwrap().is_none() {
            assert!(Instant::now() < deadline, "the coordinator never ended");
            std::thread::sleep(Duration::from_millis(20));
        }
        let mut says = String::new();
        self.coordinator.stderr.take().unwrap().read_to_string(&mut says).unwrap();
        assert_gone(&self.nodes);
        (self.coordinator.wait().unwrap().code(), says)
    }
}

/// Living children of a process.
fn children(of: u32) -> Vec<u32> {
    let pids = std::fs::read_dir("/proc").unwrap().flatten();
    let pids = pids.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    pids.filter(|&pid| stat(pid).is_some_and(|(state, parent)| parent == of && state != "Z"))
        .collect()
}

/// State and parent of a process.
fn stat(pid: u32) -> Option<(String, u32)> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let mut fields = text.rsplit_once(')')?.1.split_whitespace();
    Some((fields.next()?.to_owned(), fields.next()?.parse().ok()?))
}

/// Sends a signal; the shell has `kill` where no such program is installed.
fn signal(pid: u32, name: &str) {
    assert!(
        Command::new("sh").args(["-c", &format!("kill -{name} {pid}")]).status().unwrap().success()
    );
}

fn assert_gone(pids: &[u32]) {
    let deadline = Instant::now() + Duration::from_secs(10);
    let alive = |&pid: &u32| stat(pid).is_some_and(|(state, _)| state != "Z");
    while pids.iter().any(alive) {
        assert!(Instant::now() < deadline, "orphans: {pids:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn whatever_dies_first_nobody_stays_behind() {
    let scene = Scene::synth("plant", 200_000);
    for killed in 0..3 {
        let run = LongRun::start(&scene, &[]);
        signal(run.nodes[killed], "KILL");
        let (code, says) = run.end();
        assert_eq!(code, Some(69), "{says}");
        assert!(says.contains("seat"), "{says}");
    }
    for name in ["INT", "TERM"] {
        let out = scene.file(name);
        let run = LongRun::start(&scene, &["--out", text(&out), "--pictures", "png"]);
        signal(run.coordinator.id(), name);
        let (code, says) = run.end();
        assert_eq!(code, Some(1), "{says}");
        assert!(says.contains("interrupted"), "{says}");
        assert_whole(&out);
    }
    let mut run = LongRun::start(&scene, &[]);
    signal(run.coordinator.id(), "KILL");
    run.coordinator.wait().unwrap();
    assert_gone(&run.nodes);
}

/// The picture thread opens a pipe that nobody reads where it means to write a file, four pictures pile up, and
/// the render thread hangs handing over the next, as it would in a driver. Its process answers pings.
#[test]
fn a_render_thread_that_hangs_is_named_and_nobody_stays_behind() {
    let scene = Scene::synth("plant", 200_000);
    let out = scene.file("hang");
    let extra = ["--out", text(&out), "--pictures", "png", "--phase-limit", "3"];
    let run = LongRun::start(&scene, &extra);
    let written = std::fs::read_dir(out.join("frames")).unwrap().flatten();
    let newest =
        written.filter_map(|entry| entry.path().file_stem()?.to_str()?.parse::<u32>().ok());
    let blocked = newest.max().unwrap_or(0) + 60;
    for pid in &run.nodes {
        let pipe = out.join(format!("frames/.{blocked:06}.png.{pid}.tmp"));
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    }
    let (code, says) = run.end();
    assert_eq!(code, Some(69), "{says}");
    let hangs = format!("seat 2 has been at RVG({}) for 3 s", blocked + 5);
    assert!(says.contains(&hangs), "{says}");
    assert!(says.contains("--phase-limit"), "{says}");
}

#[test]
fn a_run_that_is_interrupted_while_it_starts_ends() {
    let scene = Scene::synth("pipes", 3_000);
    let walk = scene.path("orbit", 3000);
    for name in ["INT", "TERM"] {
        for _ in 0..4 {
            let mut command = occluster();
            command.args(["replay", text(&scene.occ), "--path", text(&walk), "--backend", "cpu"]);
            let mut run = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            while children(run.id()).is_empty() {
                assert!(run.try_wait().unwrap().is_none(), "it ended too soon");
            }
            signal(run.id(), name);
            assert_eq!(run.wait().unwrap().code(), Some(1), "{name}");
        }
    }
}

#[test]
fn two_runs_do_not_meet_in_one_folder_and_a_killed_one_leaves_it_free() {
    let scene = Scene::synth("plant", 200_000);
    let out = scene.file("one");
    let mut run = LongRun::start(&scene, &["--out", text(&out), "--pictures", "png"]);
    let replay = ["replay", text(&scene.occ), "--backend", "cpu", "--frames", "2"];
    let second =
        [&replay[..], &["--size", "32x24", "--pictures", "png", "--out", text(&out)]].concat();
    support::fail(&second, 75, text(&out));
    let deadline = Instant::now() + Duration::from_secs(30);
    while !out.join("frames/000002.png").exists() {
        assert!(Instant::now() < deadline, "it shows nothing");
        std::thread::sleep(Duration::from_millis(20));
    }
    signal(run.coordinator.id(), "KILL");
    run.coordinator.wait().unwrap();
    assert_gone(&run.nodes);
    std::fs::write(out.join("frames/.000004.png.1.tmp"), "half").unwrap();
    support::succeed(&second);
    assert_eq!(std::fs::read_dir(out.join("frames")).unwrap().count(), 2);
    assert!(out.join("summary.json").exists());
}

/// No half-written file: every picture ends as a PNG does, nothing temporary is left.
fn assert_whole(out: &Path) {
    for entry in std::fs::read_dir(out.join("frames")).unwrap() {
        let path = entry.unwrap().path();
        assert_eq!(path.extension().unwrap(), "png", "{}", path.display());
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes.ends_with(b"IEND\xaeB`\x82"), "{}", path.display());
    }
    assert!(!out.join("summary.json").exists());
}

#[test]
fn a_stranger_gets_not_one_byte_and_harms_no_run() {
    let scene = Scene::synth("plant", 200_000);
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let rig = scene.file("rig.toml");
    std::fs::write(&rig, format!("bind = \"{free}\"")).unwrap();
    let walk = scene.path("walk", 300);
    let mut coordinator = occluster()
        .args([
            "replay",
            text(&scene.occ),
            "--path",
            text(&walk),
            "--backend",
            "cpu",
            "--rig",
            text(&rig),
        ])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let deadline = Instant::now() + Duration::from_secs(30);
    let mut stranger = loop {
        match TcpStream::connect(free) {
            Ok(stream) => break stream,
            Err(_) => assert!(Instant::now() < deadline, "nobody listens"),
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    stranger.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    drop(stranger.write_all(b"GET / HTTP/1.1\r\nHost: plant\r\n\r\n"));
    let mut answer = Vec::new();
    drop(stranger.read_to_end(&mut answer));
    assert!(answer.is_empty(), "{answer:?}");
    assert!(coordinator.wait().unwrap().success());
    let table: Vec<String> =
        BufReader::new(coordinator.stdout.take().unwrap()).lines().map(Result::unwrap).collect();
    assert!(table.iter().any(|line| line.contains("frame ms")), "{table:?}");
}
