//! What will be needed next: the events that change the front under a predicted camera (paper 004,
//! sections 5.3 and 5.5).
//!
//! In the paper's order: first LOD switching, what stands for the present visible set at the levels of
//! the camera to come; then visibility, which the paper left open: what was visible not long ago, the
//! siblings of what is visible, and what enters the frustum, the nearest first. Where there is room for
//! more, what is hidden in the frustum comes last.

use crate::front::{Front, FrontEntry, box_from_eye, front};
use crate::occluders::map_onto_front;
use glam::{DMat3, DQuat, DVec3};
use protocol::camera::Camera;
use protocol::format::Skeleton;
use protocol::id::HlodId;
use protocol::settings::PictureSize;
use protocol::visible::VisibleSet;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Frames ahead that are looked at.
const AHEAD: [u32; 2] = [1, 4];
/// Frames for which what was visible counts as likely to become visible again.
const REMEMBERED: u32 = 240;

/// Cameras some frames apart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Where the eye was as many frames before the earlier camera as that is before the present one,
    /// where that is known.
    pub earlier_eye: Option<[f64; 3]>,
    /// The earlier one.
    pub before: Camera,
    /// The present one.
    pub now: Camera,
    /// Frames between them, at least 1.
    pub frames: u32,
}

impl Motion {
    /// The camera `ahead` frames after the present one if it keeps its turn, and its eye its acceleration
    /// (or its speed, where no more is known).
    pub fn predicted(&self, ahead: u32) -> Camera {
        let share = f64::from(ahead) / f64::from(self.frames.max(1));
        let (from, to) = (turn_of(&self.before), turn_of(&self.now));
        let (axis, angle) = (to * from.inverse()).normalize().to_axis_angle();
        // The short way round.
        let angle =
            if angle > std::f64::consts::PI { angle - 2.0 * std::f64::consts::PI } else { angle };
        let turned = DQuat::from_axis_angle(axis, angle * share);
        let turn = |v: [f32; 3]| {
            let v = DVec3::from_array(v.map(f64::from));
            (turned * v).normalize_or(v).to_array().map(|c| c as f32)
        };
        let eye = std::array::from_fn(|k| {
            let (now, before) = (self.now.eye[k], self.before.eye[k]);
            let way = now - before;
            let gain = self.earlier_eye.map_or(0.0, |earlier| way - (before - earlier[k]));
            now + way * share + gain * (share * (share + 1.0) / 2.0)
        });
        Camera { eye, forward: turn(self.now.forward), up: turn(self.now.up), ..self.now }
    }
}

fn turn_of(camera: &Camera) -> DQuat {
    let wide = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    let (forward, up) = (wide(camera.forward), wide(camera.up));
    DQuat::from_mat3(&DMat3::from_cols(forward.cross(up), up, -forward)).normalize()
}

/// Why something is likely to be needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// What is visible will be drawn at another level, or by another hlod.
    LodSwitch,
    /// It becomes unoccluded.
    Unoccluded,
    /// It enters the frustum.
    Entering,
    /// It is in the frustum and hidden.
    Hidden,
}

/// What a forecast is made from.
#[derive(Debug, Clone, PartialEq)]
pub struct Outlook {
    /// Where the camera goes.
    pub motion: Motion,
    /// What is visible.
    pub visible: Arc<VisibleSet>,
}

/// Remembers what was visible, and makes forecasts.
pub struct Forecaster {
    skeleton: Arc<Skeleton>,
    size: PictureSize,
    lod_px: f64,
    /// By hlod, the outlook in which it was last visible; 0 for never.
    last_visible: Vec<u32>,
    outlooks: u32,
    steps: Steps,
}

/// What is left of the present forecast.
#[derive(Default)]
struct Steps {
    outlook: Option<Outlook>,
    fronts: Vec<Front>,
    /// Entries that stand for the visible set, by horizon.
    standing: Vec<Vec<FrontEntry>>,
    /// The front of the present camera, once it is needed.
    present: Option<VisibleSet>,
    next: usize,
}

impl Forecaster {
    /// For pictures of one size and error.
    pub fn new(skeleton: Arc<Skeleton>, size: PictureSize, lod_px: f64) -> Self {
        let last_visible = vec![0; skeleton.hlods.len()];
        Self { skeleton, size, lod_px, last_visible, outlooks: 0, steps: Steps::default() }
    }

    /// Begins a new forecast in place of the last one.
    pub fn begin(&mut self, outlook: Outlook) {
        self.outlooks += 1;
        for id in outlook.visible.ids() {
            if let Some(last) = self.last_visible.get_mut(id.index()) {
                *last = self.outlooks;
            }
        }
        self.steps = Steps { outlook: Some(outlook), ..Steps::default() };
    }

    /// The next levels in order of need, some of which may have been named before; none once the
    /// forecast is complete. Each call does a part of the work.
    pub fn next_levels(&mut self) -> Option<(Event, Vec<u32>)> {
        let outlook = self.steps.outlook.clone()?;
        let step = self.steps.next;
        self.steps.next += 1;
        let (kind, horizon) = (step / AHEAD.len(), step % AHEAD.len());
        let levels = |entries: &[FrontEntry]| entries.iter().map(|entry| entry.level).collect();
        Some(match kind {
            0 => {
                let camera = outlook.motion.predicted(AHEAD[horizon]);
                let front = front(&self.skeleton, &camera, self.size, self.lod_px);
                let standing = map_onto_front(&self.skeleton, &outlook.visible, &front);
                let found = (Event::LodSwitch, levels(&standing));
                self.steps.fronts.push(front);
                self.steps.standing.push(standing);
                found
            }
            1 => (Event::Unoccluded, levels(&self.likely(horizon))),
            2 => (Event::Entering, levels(&self.entering(horizon, &outlook))),
            3 => (Event::Hidden, levels(&self.nearest_first(horizon, &outlook, |_| true))),
            _ => {
                self.steps = Steps::default();
                return None;
            }
        })
    }

    /// Entries that stand for what was visible lately, then siblings of what is visible.
    fn likely(&self, horizon: usize) -> Vec<FrontEntry> {
        let front = &self.steps.fronts[horizon];
        let oldest = self.outlooks.saturating_sub(REMEMBERED).max(1);
        let ids = (0u32..).zip(&self.last_visible);
        let lately = ids.filter(|(_, last)| **last >= oldest).map(|(id, _)| HlodId(id)).collect();
        let mut likely = map_onto_front(&self.skeleton, &VisibleSet::from_sorted(lately), front);
        let parent = |entry: &FrontEntry| self.skeleton.hlod(entry.hlod).parent;
        let parents: BTreeSet<u32> = self.steps.standing[horizon].iter().map(parent).collect();
        likely.extend(front.entries.iter().filter(|entry| parents.contains(&parent(entry))));
        likely
    }

    /// Entries that the present frustum does not hold, nearest first.
    fn entering(&mut self, horizon: usize, outlook: &Outlook) -> Vec<FrontEntry> {
        let held = self.steps.present.get_or_insert_with(|| {
            let now = front(&self.skeleton, &outlook.motion.now, self.size, self.lod_px);
            VisibleSet::from_sorted(now.entries.iter().map(|entry| entry.hlod).collect())
        });
        let standing = map_onto_front(&self.skeleton, held, &self.steps.fronts[horizon]);
        let known: BTreeSet<HlodId> = standing.iter().map(|entry| entry.hlod).collect();
        self.nearest_first(horizon, outlook, |hlod| !known.contains(&hlod))
    }

    /// Those entries whose hlod `is_meant`, by the distance of their boxes from the eye.
    fn nearest_first(
        &self,
        horizon: usize,
        outlook: &Outlook,
        is_meant: impl Fn(HlodId) -> bool,
    ) -> Vec<FrontEntry> {
        let front = &self.steps.fronts[horizon];
        let camera = outlook.motion.predicted(AHEAD[horizon]);
        let distance = |entry: &FrontEntry| {
            box_from_eye(self.skeleton.hlod(entry.hlod), camera.eye).distance(DVec3::ZERO)
        };
        let meant = front.entries.iter().filter(|entry| is_meant(entry.hlod));
        let mut sorted: Vec<(f64, FrontEntry)> =
            meant.map(|entry| (distance(entry), *entry)).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.hlod.cmp(&b.1.hlod)));
        sorted.into_iter().map(|(_, entry)| entry).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random_scene::RandomScene;

    const SIZE: PictureSize = PictureSize { width: 64, height: 48 };

    fn look(eye: [f64; 3], target: [f64; 3]) -> Camera {
        Camera::look_at(eye, target, [0.0, 0.0, 1.0], 60.0, 0.1).unwrap()
    }

    fn angle(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt()
    }

    #[test]
    fn a_steady_camera_is_predicted() {
        let at = |frame: f64| {
            let (sin, cos) = (0.3 + 0.04 * frame).sin_cos();
            let eye = [1e7 + 2.0 * frame, -frame, 3.0];
            look(eye, [eye[0] + cos, eye[1] + sin, eye[2]])
        };
        for frames in [1, 2, 5] {
            let earlier_eye = Some(at(-f64::from(frames)).eye);
            let now = at(f64::from(frames));
            let motion = Motion { earlier_eye, before: at(0.0), now, frames };
            for ahead in [0, 1, 8] {
                let (found, truth) = (motion.predicted(ahead), at(f64::from(frames + ahead)));
                assert!((0..3).all(|k| (found.eye[k] - truth.eye[k]).abs() < 1e-6));
                assert!(angle(found.forward, truth.forward) < 1e-5);
                assert!(angle(found.up, truth.up) < 1e-5);
            }
        }
    }

    #[test]
    fn an_eye_on_an_arc_is_predicted_to_the_third_order() {
        let at = |frame: f64| {
            let (sin, cos) = (0.05 * frame).sin_cos();
            look([10.0 * cos, 10.0 * sin, 0.0], [0.0; 3])
        };
        let (before, now, truth) = (at(0.0), at(1.0), at(4.0).eye);
        let off = |earlier_eye| {
            let found = Motion { earlier_eye, before, now, frames: 1 }.predicted(3).eye;
            (0..3).map(|k| (found[k] - truth[k]).powi(2)).sum::<f64>().sqrt()
        };
        let (straight, bent) = (off(None), off(Some(at(-1.0).eye)));
        assert!(straight > 0.1 && bent < 0.02, "{straight} {bent}");
    }

    #[test]
    fn a_camera_that_stands_or_turns_back_stays_a_camera() {
        let still = look([1.0, 2.0, 3.0], [4.0, 2.0, 3.0]);
        let motion = Motion { earlier_eye: None, before: still, now: still, frames: 1 };
        let found = motion.predicted(8);
        assert_eq!(found.eye, still.eye);
        assert!(angle(found.forward, still.forward) < 1e-6);
        let back = look([1.0, 2.0, 3.0], [-4.0, 2.0, 3.0]);
        let motion = Motion { earlier_eye: None, before: still, now: back, frames: 1 };
        let found = motion.predicted(3);
        let length = found.forward.iter().map(|c| c * c).sum::<f32>();
        assert!((length - 1.0).abs() < 1e-5, "{found:?}");
    }

    fn all_levels(forecaster: &mut Forecaster) -> Vec<(Event, Vec<u32>)> {
        std::iter::from_fn(|| forecaster.next_levels()).collect()
    }

    #[test]
    fn without_an_outlook_nothing_is_foreseen() {
        let scene = RandomScene::new(1, 2, 16.0);
        let mut forecaster = Forecaster::new(Arc::new(scene.skeleton), SIZE, 1.0);
        assert!(forecaster.next_levels().is_none());
    }

    #[test]
    fn levels_come_in_the_order_of_the_events_and_belong_to_the_fronts_to_come() {
        for seed in 0..20 {
            let mut scene = RandomScene::new(seed, 4, 16.0);
            let (before, now) = (scene.camera(), scene.camera());
            let motion = Motion { earlier_eye: None, before, now, frames: 8 };
            let skeleton = Arc::new(scene.skeleton);
            let here = front(&skeleton, &now, SIZE, 2.0);
            let ids = here.entries.iter().step_by(3).map(|entry| entry.hlod).collect();
            let visible = Arc::new(VisibleSet::from_sorted(ids));
            let mut forecaster = Forecaster::new(Arc::clone(&skeleton), SIZE, 2.0);
            forecaster.begin(Outlook { motion, visible: Arc::clone(&visible) });
            let found = all_levels(&mut forecaster);
            assert_eq!(found.len(), 4 * AHEAD.len());
            for (step, (event, levels)) in found.iter().enumerate() {
                let ahead = AHEAD[step % AHEAD.len()];
                let expected =
                    [Event::LodSwitch, Event::Unoccluded, Event::Entering, Event::Hidden];
                assert_eq!(*event, expected[step / AHEAD.len()]);
                let then = front(&skeleton, &motion.predicted(ahead), SIZE, 2.0);
                let is_there = |level: &u32| then.entries.iter().any(|e| e.level == *level);
                assert!(levels.iter().all(is_there), "seed {seed} step {step}");
                if *event == Event::LodSwitch {
                    let standing = map_onto_front(&skeleton, &visible, &then);
                    assert_eq!(standing.len(), levels.len());
                }
            }
            assert!(forecaster.next_levels().is_none());
        }
    }

    #[test]
    fn together_the_events_name_the_whole_front_to_come_of_a_fast_turn() {
        let mut scene = RandomScene::new(5, 4, 16.0);
        let now = scene.camera();
        let skeleton = Arc::new(scene.skeleton);
        let back = Camera { forward: now.forward.map(|c| -c), ..now };
        let motion = Motion { earlier_eye: None, before: back, now, frames: 1 };
        let here = front(&skeleton, &now, SIZE, 0.0);
        let ids = here.entries.iter().map(|entry| entry.hlod).collect();
        let visible = Arc::new(VisibleSet::from_sorted(ids));
        let mut forecaster = Forecaster::new(Arc::clone(&skeleton), SIZE, 0.0);
        forecaster.begin(Outlook { motion, visible });
        let named: BTreeSet<u32> =
            all_levels(&mut forecaster).into_iter().flat_map(|(_, levels)| levels).collect();
        for ahead in AHEAD {
            let then = front(&skeleton, &motion.predicted(ahead), SIZE, 0.0);
            assert!(then.entries.iter().all(|entry| named.contains(&entry.level)));
        }
    }

    #[test]
    fn what_was_visible_is_remembered() {
        let mut scene = RandomScene::new(8, 3, 16.0);
        let now = scene.camera();
        let skeleton = Arc::new(scene.skeleton);
        let motion = Motion { earlier_eye: None, before: now, now, frames: 1 };
        let here = front(&skeleton, &now, SIZE, 0.0);
        let last = here.entries.last().unwrap().hlod;
        let mut forecaster = Forecaster::new(Arc::clone(&skeleton), SIZE, 0.0);
        let set = |ids| Arc::new(VisibleSet::from_sorted(ids));
        forecaster.begin(Outlook { motion, visible: set(vec![last]) });
        forecaster.begin(Outlook { motion, visible: set(vec![]) });
        let found = all_levels(&mut forecaster);
        let level = here.entries.last().unwrap().level;
        for (event, levels) in found {
            let is_named = matches!(event, Event::Unoccluded | Event::Hidden);
            assert_eq!(levels.contains(&level), is_named, "{event:?}");
        }
    }
}
