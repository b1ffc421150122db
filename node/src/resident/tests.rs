//! The loader against a source that never pauses, with the CPU backend.

use super::*;
use crate::fixture::{Piece, write};
use crate::io_thread::Source;
use protocol::format::{Blob, Class};
use protocol::settings::PictureSize;
use scene::backend::Draw;
use scene::backend::cpu::CpuBackend;
use scene::prefetch::Forecaster;
use scene::store::{Store, StoreError};
use std::time::Duration;

const SIZE: PictureSize = PictureSize { width: 64, height: 48 };
/// Meshes of the scene, and vertices of each: 64 KiB.
const MESHES: u32 = 1000;
const VERTICES: u32 = 4096;
const MIB: u64 = 1 << 20;

/// Gives any mesh at once: vertices of zeros and triangles of the first of them.
struct Ready;

impl Source for Ready {
    fn read(&self, _: Asset, out: &mut [u8]) -> Result<(), StoreError> {
        out.fill(0);
        Ok(())
    }
}

/// A thousand boxes, each with a mesh of its own, in a cube before the eye.
fn skeleton() -> Arc<Skeleton> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    let place = |n: u32| [n % 10, n / 10 % 10, n / 100].map(|c| f64::from(c) * 2.0);
    let pieces: Vec<Piece> =
        (0..MESHES).map(place).map(|at| Piece::tight(at, at.map(|c| c + 1.0))).collect();
    write(&path, &pieces, false);
    let mut skeleton = Skeleton::clone(Store::open(&path).unwrap().skeleton());
    let mesh = Blob {
        bytes: u64::from(VERTICES) * 16 + 12,
        vertices: VERTICES,
        triangles: 2,
        classes: Class::OpaqueDouble.all(2),
        ..skeleton.blobs[0]
    };
    skeleton.blobs = vec![mesh; MESHES as usize];
    skeleton.parts.iter_mut().zip(0..).for_each(|(part, place)| part.blob = place);
    Arc::new(skeleton)
}

fn camera() -> Camera {
    let (eye, target) = ([10.0, -40.0, 10.0], [10.0, 10.0, 10.0]);
    Camera::look_at(eye, target, [0.0, 0.0, 1.0], 60.0, 0.05).unwrap()
}

/// A loader of that scene, whose buffers hold all of it.
fn loader(skeleton: &Arc<Skeleton>) -> Loader {
    let mesh = skeleton.blobs[0].bytes;
    let budget =
        Budget { skeleton: 0, host: 128 * MIB, reserve: mesh, device: 1 << 30, textures: 0 };
    let forecaster = Forecaster::new(Arc::clone(skeleton), Arc::default(), SIZE, 0.0);
    let buffers = [budget.host, budget.reserve];
    let io = IoThread::start(Ready, Arc::clone(skeleton), forecaster, None, buffers).unwrap();
    Loader::new(Arc::clone(skeleton), io, budget, true, Arc::default())
}

/// A list of one draw.
fn draws(blob: u32) -> Draws {
    let (blob, item) = (BlobId(blob), protocol::id::HlodId(1));
    let (linear, offset) = ([[0.0; 3]; 3], [0.0; 3]);
    let draw = Draw { blob, item, linear, offset, distance: 0.0, disparity_step: 0.0 };
    Draws { solid: vec![draw], blending: vec![] }
}

fn draw(loader: &mut Loader, backend: &mut CpuBackend, blob: u32) {
    let drawn = loader.stream(backend, &draws(blob), Needs::Look, |_, _, _| Ok(())).unwrap();
    assert_eq!(drawn, Drawn::Whole);
}

/// All of the scene is visible, and will be.
fn sees_all(loader: &mut Loader, skeleton: &Skeleton) {
    loader.look_ahead(Some((FrameIndex(0), camera())), vec![FrameIndex(0), FrameIndex(1)]);
    let all = (0..skeleton.hlods.len() as u32).map(protocol::id::HlodId).collect();
    loader.note_visible(FrameIndex(0), &Arc::new(VisibleSet::from_sorted(all)));
}

fn until(what: &str, is_so: impl Fn() -> bool) {
    let waited = (0..2000).any(|_| {
        std::thread::sleep(Duration::from_millis(5));
        is_so()
    });
    assert!(waited, "{what}");
}

#[test]
fn a_drawing_uploads_what_it_lacks_and_no_more_than_16_mib_besides() {
    let skeleton = skeleton();
    let mesh = skeleton.blobs[0].bytes;
    let mut loader = loader(&skeleton);
    let mut backend = CpuBackend::new(SIZE);
    // All of it is foreseen, and most of it waits to be taken in.
    sees_all(&mut loader, &skeleton);
    until("nothing was read ahead", || loader.io.arrivals.len() > 900);

    // A list finds what it lacks behind all the rest, and leaves that where it is.
    let last = (0..MESHES).rev().find(|&id| !loader.io.claims.has(Asset::Blob(BlobId(id))));
    loader.now += 1;
    draw(&mut loader, &mut backend, last.unwrap_or(MESHES - 1));
    assert_eq!(backend.held_bytes(), mesh, "what nobody waits for was uploaded, too");

    let mut lacked = 0;
    for wanted in [998, 0, 500] {
        let before = backend.held_bytes();
        loader.begin_drawing(&mut backend).unwrap();
        let was_there = loader.residency.holds(Asset::Blob(BlobId(wanted)));
        draw(&mut loader, &mut backend, wanted);
        // A seat that idles takes in no more either.
        let (jobs, inbox) = crossbeam_channel::bounded(1);
        let later = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(100));
            jobs.send(()).unwrap();
        });
        assert_eq!(loader.take_in_until(&mut backend, &inbox).unwrap(), Some(()));
        later.join().unwrap();

        let counts = loader.take_counts();
        let own = if was_there { 0 } else { mesh };
        lacked += own;
        assert!(counts.besides <= 16 * MIB, "{} bytes besides", counts.besides);
        assert_eq!(backend.held_bytes() - before, own + counts.besides, "{wanted}: all is counted");
        assert!(counts.besides > 15 * MIB, "{} bytes: a weak test", counts.besides);
    }
    assert!(lacked > 0, "nothing was lacked: a weak test");
}

#[test]
fn nothing_is_read_ahead_before_anything_is_known_to_be_visible() {
    let skeleton = skeleton();
    let mut loader = loader(&skeleton);
    loader.look_ahead(Some((FrameIndex(0), camera())), vec![FrameIndex(0), FrameIndex(1)]);
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(loader.io.arrivals.len(), 0, "all that the frustum holds is read at the start");
    sees_all(&mut loader, &skeleton);
    until("nothing was read ahead", || !loader.io.arrivals.is_empty());
}

#[test]
fn what_was_read_ahead_and_waits_is_drawn_without_being_read_again() {
    let skeleton = skeleton();
    let mut loader = loader(&skeleton);
    let mut backend = CpuBackend::new(SIZE);
    sees_all(&mut loader, &skeleton);
    until("not all was read ahead", || loader.io.arrivals.len() == MESHES as usize);
    loader.now += 1;
    for wanted in (0..MESHES).step_by(7) {
        draw(&mut loader, &mut backend, wanted);
    }
    let counts = loader.take_counts();
    assert_eq!((counts.waits, counts.besides), (0, 0));
    assert_eq!(counts.misses, u64::from(MESHES.div_ceil(7)));
    let all = u64::from(MESHES) * skeleton.blobs[0].bytes;
    assert!(counts.bytes_read <= all, "something was read twice");
    assert!(counts.stall_ns > 0, "uploads are waited for");
}
