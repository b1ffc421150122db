//! What will be needed next: the events that change the front under a predicted camera (paper 004,
//! sections 5.3 and 5.5).
//!
//! In the paper's order, camera after camera: first LOD switching, what stands for the present visible set
//! at the levels of the camera to come; then visibility, which the paper left open: what was visible not
//! long ago, the siblings of what is visible, and what enters the frustum, the nearest first. Where there
//! is room for more, what is hidden in the frustum comes last.

use crate::front::{Front, FrontEntry, box_from_eye, front_of};
use crate::occluders::map_onto_front;
use crate::view_cells::Cells;
use glam::DVec3;
use protocol::camera::Camera;
use protocol::format::Skeleton;
use protocol::id::HlodId;
use protocol::settings::PictureSize;
use protocol::visible::VisibleSet;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Outlooks for which what was visible counts as likely to become visible again.
const REMEMBERED: u32 = 240;

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

impl Event {
    /// Only what is visible there will tell whether it is needed.
    pub fn is_guess(self) -> bool {
        matches!(self, Self::Entering | Self::Hidden)
    }
}

/// What a forecast names, in order of need: events, and under which of the cameras ahead. Of what is
/// hidden only the nearest camera's counts: until a later one comes, there will be a newer forecast.
const STEPS: [(Event, usize); 7] = [
    (Event::LodSwitch, 0),
    (Event::Unoccluded, 0),
    (Event::Entering, 0),
    (Event::LodSwitch, 1),
    (Event::Unoccluded, 1),
    (Event::Entering, 1),
    (Event::Hidden, 0),
];
/// Cameras that a forecast looks at; those beyond are not.
pub const LOOKED_AHEAD: usize = 2;

/// What a forecast is made from.
#[derive(Debug, Clone, PartialEq)]
pub struct Outlook {
    /// The camera drawn last, if any was.
    pub drawn: Option<Camera>,
    /// The cameras to be drawn next, known or predicted ([`crate::trajectory`]), the nearest in time
    /// first; [`LOOKED_AHEAD`] of them are looked at.
    pub ahead: Vec<Camera>,
    /// What is visible, as far as is known; empty where nothing is.
    pub visible: Arc<VisibleSet>,
}

/// Remembers what was visible, and makes forecasts.
pub struct Forecaster {
    skeleton: Arc<Skeleton>,
    cells: Arc<Cells>,
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
    /// What the front of the last drawing held, once it is needed.
    present: Option<VisibleSet>,
    next: usize,
}

impl Forecaster {
    /// For pictures of one size and error, with far fields in `cells`.
    pub fn new(skeleton: Arc<Skeleton>, cells: Arc<Cells>, size: PictureSize, lod_px: f64) -> Self {
        let last_visible = vec![0; skeleton.hlods.len()];
        Self { skeleton, cells, size, lod_px, last_visible, outlooks: 0, steps: Steps::default() }
    }

    fn front(&self, camera: &Camera) -> Front {
        let field = self.cells.field_at(camera.eye);
        front_of(&self.skeleton, camera, self.size, self.lod_px, &field)
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
        let left = STEPS.iter().skip(self.steps.next);
        let Some(skipped) = left.clone().position(|(_, camera)| *camera < outlook.ahead.len())
        else {
            self.steps = Steps::default();
            return None;
        };
        let (event, horizon) = STEPS[self.steps.next + skipped];
        self.steps.next += skipped + 1;
        let entries = match event {
            Event::LodSwitch => {
                let front = self.front(&outlook.ahead[horizon]);
                let standing = map_onto_front(&self.skeleton, &outlook.visible, &front);
                self.steps.fronts.push(front);
                self.steps.standing.push(standing.clone());
                standing
            }
            Event::Unoccluded => self.likely(horizon),
            Event::Entering => self.entering(horizon, &outlook),
            Event::Hidden => self.nearest_first(horizon, &outlook, |_| true),
        };
        Some((event, entries.iter().map(|entry| entry.level).collect()))
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

    /// Entries that the frustum of the last drawing did not hold, nearest first.
    fn entering(&mut self, horizon: usize, outlook: &Outlook) -> Vec<FrontEntry> {
        if self.steps.present.is_none() {
            let entries = outlook.drawn.map(|camera| self.front(&camera).entries);
            let ids = entries.unwrap_or_default().iter().map(|entry| entry.hlod).collect();
            self.steps.present = Some(VisibleSet::from_sorted(ids));
        }
        let held = self.steps.present.as_ref().expect("made if it was not there");
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
        let camera = &outlook.ahead[horizon];
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
    use crate::front::front;
    use crate::random_scene::RandomScene;

    const SIZE: PictureSize = PictureSize { width: 64, height: 48 };

    fn all_levels(forecaster: &mut Forecaster) -> Vec<(Event, Vec<u32>)> {
        std::iter::from_fn(|| forecaster.next_levels()).collect()
    }

    #[test]
    fn without_an_outlook_nothing_is_foreseen() {
        let scene = RandomScene::new(1, 2, 16.0);
        let mut forecaster = Forecaster::new(Arc::new(scene.skeleton), Arc::default(), SIZE, 1.0);
        assert!(forecaster.next_levels().is_none());
        let visible = Arc::new(VisibleSet::from_sorted(vec![HlodId(0)]));
        forecaster.begin(Outlook { drawn: None, ahead: vec![], visible });
        assert!(forecaster.next_levels().is_none());
    }

    #[test]
    fn levels_come_in_the_order_of_the_events_and_belong_to_the_fronts_to_come() {
        for seed in 0..20 {
            let mut scene = RandomScene::new(seed, 4, 16.0);
            let (now, ahead) = (scene.camera(), vec![scene.camera(), scene.camera()]);
            let skeleton = Arc::new(scene.skeleton);
            let here = front(&skeleton, &now, SIZE, 2.0);
            let ids = here.entries.iter().step_by(3).map(|entry| entry.hlod).collect();
            let visible = Arc::new(VisibleSet::from_sorted(ids));
            let mut forecaster = Forecaster::new(Arc::clone(&skeleton), Arc::default(), SIZE, 2.0);
            let outlook = Outlook { drawn: Some(now), ahead, visible: Arc::clone(&visible) };
            forecaster.begin(outlook.clone());
            let found = all_levels(&mut forecaster);
            assert_eq!(found.len(), STEPS.len());
            for ((event, levels), expected) in found.iter().zip(STEPS) {
                assert_eq!(*event, expected.0);
                let then = front(&skeleton, &outlook.ahead[expected.1], SIZE, 2.0);
                let is_there = |level: &u32| then.entries.iter().any(|e| e.level == *level);
                assert!(levels.iter().all(is_there), "seed {seed} {expected:?}");
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
        let here = front(&skeleton, &now, SIZE, 0.0);
        let ids = here.entries.iter().map(|entry| entry.hlod).collect();
        let visible = Arc::new(VisibleSet::from_sorted(ids));
        let mut forecaster = Forecaster::new(Arc::clone(&skeleton), Arc::default(), SIZE, 0.0);
        forecaster.begin(Outlook { drawn: Some(now), ahead: vec![back, now], visible });
        let named: BTreeSet<u32> =
            all_levels(&mut forecaster).into_iter().flat_map(|(_, levels)| levels).collect();
        for ahead in [back, now] {
            let then = front(&skeleton, &ahead, SIZE, 0.0);
            assert!(then.entries.iter().all(|entry| named.contains(&entry.level)));
        }
    }

    #[test]
    fn what_was_visible_is_remembered() {
        let mut scene = RandomScene::new(8, 3, 16.0);
        let now = scene.camera();
        let skeleton = Arc::new(scene.skeleton);
        let here = front(&skeleton, &now, SIZE, 0.0);
        let last = here.entries.last().unwrap().hlod;
        let mut forecaster = Forecaster::new(Arc::clone(&skeleton), Arc::default(), SIZE, 0.0);
        let outlook = |ids| {
            let visible = Arc::new(VisibleSet::from_sorted(ids));
            Outlook { drawn: Some(now), ahead: vec![now], visible }
        };
        forecaster.begin(outlook(vec![last]));
        forecaster.begin(outlook(vec![]));
        let found = all_levels(&mut forecaster);
        let level = here.entries.last().unwrap().level;
        for (event, levels) in found {
            let is_named = matches!(event, Event::Unoccluded | Event::Hidden);
            assert_eq!(levels.contains(&level), is_named, "{event:?}");
        }
    }
}
