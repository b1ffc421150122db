//! What an audit sees: culling at fault and nothing else where geometry is missing, a frustum or a front
//! at fault where it is held against the whole scene.

use super::*;
use crate::fixture::write_with_stand_in;
use protocol::telemetry::Audit;
use scene::front::box_from_eye;
use scene::view::frustum;

/// Box 2 is hidden by wall 4, which with box 5 makes the group 1; pillar 3 stands beside them. What stands for
/// the group, and errs by `error`, has no wall.
fn yard(path: &Path, error: f64) {
    let hidden = Piece::tight([-0.5, 12.0, -0.5], [0.5, 13.0, 0.5]);
    let pillar = Piece::tight([-4.0, 9.0, -1.0], [-3.5, 9.5, 1.0]);
    let wall = Piece::tight([-2.0, 8.0, -2.0], [2.0, 9.0, 2.0]);
    let right = Piece::tight([3.0, 9.0, -1.0], [4.0, 10.0, 1.0]);
    let coarse = Piece::tight([3.0, 9.0, -1.0], [4.5, 10.0, 1.0]);
    write_with_stand_in(path, &[hidden, pillar], &[wall, right], coarse, error);
}

const AHEAD: [f64; 3] = [0.5, 10.0, 0.0];

/// Draws hlods `visible` of the yard under a deadline, and audits the picture. The group's level and what
/// stands alone are there; of wall and box, the group's own, `there` are.
fn audited(there: &[u32], visible: &[u32]) -> (Audit, u32) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    yard(&path, 0.5);
    let settings = RunSettings {
        residency: Residency::Deadline,
        prefetch: false,
        lod_px: 0.0,
        ..settings(&path, Cull::Queries)
    };
    let mut stage = stage(&settings, Rules::default(), &Arc::default());
    let levels = there.iter().map(|&id| FrontEntry { hlod: HlodId(id), level: id - 1 });
    let levels: Vec<FrontEntry> = levels.collect();
    let camera = look([0.0; 3], AHEAD);
    // An earlier drawing had them.
    stage.begin_drawing().unwrap();
    let whole = Composition { cell: None, weight: WHOLE };
    let pass =
        |view, draws: Draws, part| Pass::Occluders { view, draws: draws.solid, adds: false, part };
    stage.draw(&whole, &camera, &levels, Promise::Exact, pass).unwrap();

    let visible = VisibleSet::from_sorted(visible.iter().copied().map(HlodId).collect());
    let drawn = render_visible_geometry::run(&mut stage, &camera, &visible, true).unwrap();
    stage.take_io();
    let before = stage.loader.residency().clone();
    let measured = measure(&mut stage, &camera, &drawn, true, true).unwrap();

    // So the next frames are the ones there would have been without it.
    assert_eq!(*stage.loader.residency(), before, "an audit counts as use, or makes room");
    assert_eq!(IoCounts { hits: 0, ..stage.take_io() }, IoCounts::default(), "an audit reads");
    (measured.unwrap().audit.unwrap(), drawn.counts.missing.replaced)
}

#[test]
fn beside_a_deadline_stand_ins_are_no_lost_pixels_and_the_audit_reads_nothing() {
    let (audit, replaced) = audited(&[4, 5], &[3, 4, 5]);
    assert_eq!((audit, replaced), (Audit::default(), 0), "all is there");
    // Without the wall nobody knows what is behind it; the rest is compared.
    let (audit, replaced) = audited(&[5], &[3, 4, 5]);
    assert_eq!((audit.differing_pixels, audit.front_faults, replaced), (0, 0, 2));
    let pixels = u64::from(SIZE.width * SIZE.height);
    assert!(audit.unknown_pixels > 100 && audit.unknown_pixels < pixels / 2, "{audit:?}");
}

#[test]
fn beside_a_deadline_what_culling_loses_is_seen() {
    // The wall, and then the pillar while the wall is stood in for.
    let (audit, replaced) = audited(&[4, 5], &[3, 5]);
    assert!(audit.differing_pixels > 100 && audit.unknown_pixels == 0, "{audit:?}");
    assert_eq!(replaced, 0);
    let (audit, replaced) = audited(&[5], &[4, 5]);
    assert!(audit.differing_pixels > 10 && audit.unknown_pixels > 100, "{audit:?}");
    assert_eq!(replaced, 2);
}

/// Draws a front of the yard whole, and audits it against `against`.
fn audited_front(
    against: AuditAgainst,
    lod_px: f64,
    front_of: impl Fn(&Stage<'_>, &Camera) -> Vec<FrontEntry>,
) -> Audit {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.occ");
    yard(&path, 0.05);
    let settings = RunSettings { audit_against: against, lod_px, ..settings(&path, Cull::Queries) };
    let mut stage = stage(&settings, Rules::default(), &Arc::default());
    let camera = look([0.0; 3], AHEAD);
    let entries = front_of(&stage, &camera);
    let ids = entries.iter().map(|entry| entry.hlod).collect();
    stage.front = Some((camera, Arc::new(Front { entries, ..Front::default() })));

    let visible = VisibleSet::from_sorted(ids);
    let drawn = render_visible_geometry::run(&mut stage, &camera, &visible, true).unwrap();
    measure(&mut stage, &camera, &drawn, true, false).unwrap().unwrap().audit.unwrap()
}

/// What the frustum holds of the whole cut, with one of its planes turned round if asked for.
fn held(stage: &Stage<'_>, camera: &Camera, turned: Option<usize>) -> Vec<FrontEntry> {
    let mut normals = frustum(camera, SIZE).normals();
    turned.into_iter().for_each(|plane| normals[plane] = -normals[plane]);
    let mut entries = stage.whole_cut(camera);
    entries.retain(|entry| {
        let seen = box_from_eye(stage.skeleton.hlod(entry.hlod), camera.eye);
        normals
            .iter()
            .all(|&normal| (normal * seen.min).max(normal * seen.max).element_sum() >= 0.0)
    });
    entries
}

#[test]
fn against_the_scene_a_frustum_plane_of_the_wrong_sign_is_seen() {
    for lod_px in [0.0, 1.0, 40.0] {
        let of = |against, turned| {
            audited_front(against, lod_px, |stage, camera| held(stage, camera, turned))
        };
        assert_eq!(of(AuditAgainst::Scene, None), Audit::default());
        let mut seen = 0;
        for plane in 0..5 {
            assert_eq!(of(AuditAgainst::Front, Some(plane)), Audit::default(), "it is blind");
            let audit = of(AuditAgainst::Scene, Some(plane));
            assert_eq!(audit.front_faults, 0, "all that is left is as it should be");
            seen += u32::from(audit.differing_pixels > 100);
        }
        assert_eq!(seen, 5);
    }
}

#[test]
fn against_the_scene_a_level_that_is_too_coarse_is_seen() {
    let coarse = |stage: &Stage<'_>, camera: &Camera| {
        let mut entries = stage.whole_cut(camera);
        entries.retain(|entry| entry.hlod.0 < 4);
        entries.insert(0, FrontEntry { hlod: HlodId(1), level: 0 });
        entries
    };
    for lod_px in [0.0, 0.1] {
        assert_eq!(audited_front(AuditAgainst::Front, lod_px, coarse), Audit::default());
        let audit = audited_front(AuditAgainst::Scene, lod_px, coarse);
        assert!(audit.front_faults == 1 && audit.differing_pixels > 10, "{audit:?}");
    }
    // At forty pixels it is as it should be.
    let fits = |stage: &Stage<'_>, camera: &Camera| {
        let cut = stage.whole_cut(camera);
        assert_eq!(cut, [0, 1, 2].map(|at| FrontEntry { hlod: HlodId(at + 1), level: at }));
        cut
    };
    assert_eq!(audited_front(AuditAgainst::Scene, 40.0, fits), Audit::default());
}
