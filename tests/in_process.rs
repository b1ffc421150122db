//! Three nodes as threads, driven by the coordinator through pipes: the same code as three processes.

#![allow(clippy::unwrap_used, reason = "a test stops where something is missing")]

#[path = "../node/src/fixture.rs"]
#[allow(dead_code, reason = "the tests of the node use the rest")]
mod fixture;

use coordinator::record::RunRecord;
use coordinator::run::{Rig, RunError, RunPlan, run};
use fixture::{street, write};
use protocol::camera::Camera;
use protocol::message::FailureKind;
use protocol::schedule::{Phase, Role};
use protocol::session::coordinator::Policy;
use protocol::settings::{
    AuditAgainst, BackendChoice, Cull, PictureSize, Residency, RunSettings, Schedule,
};
use protocol::sun::Sun;
use protocol::telemetry::WorkReport;
use std::path::Path;

const SIZE: PictureSize = PictureSize { width: 64, height: 40 };

fn cameras(frames: u32) -> Vec<Camera> {
    let camera = |i| {
        let x = f64::from(i) * 1.5;
        let look = Camera::look_at([x, -3.0, 2.0], [x + 1.0, 6.0, 2.5], [0.0, 0.0, 1.0], 60.0, 0.1);
        look.unwrap()
    };
    (0..frames).map(camera).collect()
}

fn threads() -> Rig {
    Rig::Threads(Box::new(|ends, token| {
        node::run_in_process(ends, token)
            .map_err(|error| RunError::Failed { kind: error.kind, reason: error.reason })
    }))
}

/// Replays a walk of `frames` pictures in a new scene file under `folder`.
fn replay(
    folder: &Path,
    frames: u32,
    change: impl FnOnce(&mut RunSettings),
) -> Result<RunRecord, RunError> {
    let scene = folder.join("scene.occ");
    let digest = write(&scene, &street(), false).digest;
    let mut settings = RunSettings {
        scene_path: scene.to_str().unwrap().to_owned(),
        scene_digest: digest,
        size: SIZE,
        lod_px: 1.0,
        sun: Sun::default(),
        cull: Cull::Queries,
        schedule: Schedule::Switch,
        backend: BackendChoice::Cpu,
        frames,
        audit_every: 1,
        audit_against: AuditAgainst::Front,
        items_every: 2,
        memory: None,
        residency: Residency::Exact,
        prefetch: true,
        far: protocol::settings::Far::Off,
        far_cubes: 8,
        far_triangles: None,
        pictures_dir: Some(folder.join("frames").to_str().unwrap().to_owned()),
    };
    change(&mut settings);
    let mut phases_seen = 0;
    let (policy, memory_cap) = (Policy::default(), None);
    let plan = RunPlan { settings, cameras: cameras(frames), rig: threads(), policy, memory_cap };
    let record = run(plan, &mut |_| phases_seen += 1)?;
    assert_eq!(phases_seen, record.phases.len());
    Ok(record)
}

/// Work of one role, by frame.
fn work(record: &RunRecord, role: Role) -> Vec<WorkReport> {
    let reports = record.phases.iter().flat_map(|phase| &phase.reports);
    let mut work: Vec<_> = reports.filter_map(|(_, report)| report.work).collect();
    work.retain(|work| work.role == role);
    work.sort_by_key(|work| work.frame);
    work
}

fn hashes(record: &RunRecord) -> Vec<u64> {
    record.pictures.values().map(|picture| picture.hash).collect()
}

#[test]
fn a_walk_is_replayed_without_a_lost_pixel() {
    let folder = tempfile::tempdir().unwrap();
    let record = replay(folder.path(), 8, |_| ()).unwrap();
    assert_eq!((record.processes, record.nodes.len()), (1, 3));
    assert_eq!(record.phases.first().unwrap().phase, Phase::FIRST);
    assert!(record.phases.iter().all(|phase| phase.reports.len() == 3));
    let drawn = work(&record, Role::RenderVisibleGeometry);
    let culled = work(&record, Role::HardwareCull);
    assert_eq!((drawn.len(), culled.len()), (8, 8));
    assert_eq!(
        record.pictures.keys().map(|frame| frame.0).collect::<Vec<_>>(),
        Vec::from_iter(0..8)
    );
    for (drawn, culled) in drawn.iter().zip(&culled) {
        let (draw, cull) = (drawn.draw.unwrap(), culled.cull.unwrap());
        assert_eq!(draw.audit.unwrap().differing_pixels, 0);
        assert_eq!(draw.hlods, cull.visible);
        assert!(
            draw.hlods_with_pixels.is_some(),
            "where a picture is audited, what it shows is counted"
        );
        assert!(culled.visible_sent.is_some() && drawn.visible_received.is_some());
    }
    // The wall hides the lattice.
    let last = culled[7].cull.unwrap();
    assert!(last.visible * 2 < last.in_frustum, "{last:?}");
    for frame in 0..8 {
        let picture = folder.path().join(format!("frames/{frame:06}.png"));
        assert!(std::fs::metadata(picture).unwrap().len() > 100);
    }
}

#[test]
fn bytes_of_a_frame_are_counted_in_its_phase() {
    let folder = tempfile::tempdir().unwrap();
    let record = replay(folder.path(), 6, |_| ()).unwrap();
    let mut before = 0;
    for phase in &record.phases {
        let reports = phase.reports.iter();
        let links = reports.flat_map(|(_, report)| &report.sent).map(|link| link.bytes);
        let sent: u64 = links.sum();
        let has_cull = phase.phase != Phase::FIRST;
        assert_eq!(sent > before, has_cull || before == 0, "{:?}", phase.phase);
        before = sent;
    }
    assert!(record.phases.iter().is_sorted_by_key(|phase| phase.control_sent));
}

#[test]
fn both_schedules_and_a_second_run_give_the_same_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let first = hashes(&replay(folder.path(), 7, |_| ()).unwrap());
    assert_eq!(first.len(), 7);
    assert_eq!(first, hashes(&replay(folder.path(), 7, |_| ()).unwrap()));
    let rotated = |settings: &mut RunSettings| settings.schedule = Schedule::Rotate;
    assert_eq!(first, hashes(&replay(folder.path(), 7, rotated).unwrap()));
    let unculled = |settings: &mut RunSettings| settings.cull = Cull::Off;
    assert_eq!(first, hashes(&replay(folder.path(), 7, unculled).unwrap()));
}

#[test]
fn one_picture_is_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let record = replay(folder.path(), 1, |_| ()).unwrap();
    assert_eq!(hashes(&record).len(), 1);
}

#[test]
fn failures_of_a_node_reach_the_caller_by_kind() {
    let folder = tempfile::tempdir().unwrap();
    let failure =
        |change: &dyn Fn(&mut RunSettings)| match replay(folder.path(), 2, change).unwrap_err() {
            RunError::Failed { kind, reason } => (kind, reason),
            RunError::Interrupted => panic!("nobody interrupted"),
        };
    let (kind, reason) = failure(&|settings| settings.scene_path += ".gone");
    assert_eq!(kind, FailureKind::NoInput, "{reason}");
    assert!(reason.contains("scene.occ.gone"), "{reason}");
    let (kind, reason) = failure(&|settings| settings.scene_digest[0] ^= 1);
    assert_eq!(kind, FailureKind::NotAllowed, "{reason}");
    let blocked = folder.path().join("scene.occ/frames");
    let blocked = blocked.to_str().unwrap().to_owned();
    let (kind, reason) = failure(&|settings| settings.pictures_dir = Some(blocked.clone()));
    assert_eq!(kind, FailureKind::Io, "{reason}");
    assert!(reason.contains("scene.occ/frames"), "{reason}");
}
