//! HC(i): V_i, the part of the front F_i whose boxes pass against the depth of OR(i) (paper 004,
//! sections 4.2 and 4.4).
//!
//! Answers are handed on as the backend gives them, in id order: the receivers of V_i read them while the
//! rest is being tested, and begin to work when all have come. A backend answers some thousands of boxes
//! at once, so in a scene with fewer nothing overlaps.

use super::{RoleError, Stage};
use protocol::camera::Camera;
use protocol::id::HlodId;
use protocol::settings::Cull;
use protocol::telemetry::CullCounts;
use scene::backend::{BoxQuery, Completion, Pass};
use scene::front::FrontEntry;
use scene::occludee::{Test, test_for};

/// A stretch of V_i.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Part {
    /// Last hlod of the front that is decided; the next part begins behind it.
    pub(crate) through: HlodId,
    /// Visible ones up to there that no earlier part named, in id order.
    pub(crate) visible: Vec<HlodId>,
}

/// Finds V_i and hands it to `tell` in parts. What the wire makes of it is counted elsewhere:
/// `leaving`, `entering` and all `ids_*` stay 0.
pub(crate) fn run(
    stage: &mut Stage<'_>,
    camera: &Camera,
    mut tell: impl FnMut(Part),
) -> Result<CullCounts, RoleError> {
    let front = stage.front(camera);
    let (tests, boxes) = split(stage, camera, &front.entries);
    let mut counts = CullCounts {
        front: front.total,
        in_frustum: front.entries.len() as u32,
        queries: boxes.len() as u32,
        source_triangles_in_frustum: front.source_triangles_in_frustum,
        ..CullCounts::default()
    };
    let mut progress =
        Progress { entries: &front.entries, tested: &tests, decided: 0, answered: 0 };
    let mut hand_on = |part: Option<Part>| {
        if let Some(part) = part {
            counts.visible += part.visible.len() as u32;
            tell(part);
        }
    };
    if boxes.is_empty() {
        hand_on(progress.advance(&[], true));
        return Ok(counts);
    }
    let (view, method) = (stage.view(camera), stage.settings.cull);
    let submitted = stage.backend.submit(Pass::QueryBoxes { view, boxes, method })?;
    let mut completions = Vec::new();
    let mut more = true;
    while more {
        stage.backend.poll(&mut completions)?;
        for completion in completions.drain(..) {
            let Completion::Boxes { ticket, first, visible, last } = completion else {
                unreachable!("boxes answer as such")
            };
            assert_eq!((ticket, first), (submitted, progress.answered), "answers come in order");
            hand_on(progress.advance(&visible, last));
            more = !last;
        }
    }
    Ok(counts)
}

/// Which entries need a test, one flag each, and the boxes of those that do.
fn split(stage: &Stage<'_>, camera: &Camera, entries: &[FrontEntry]) -> (Vec<bool>, Vec<BoxQuery>) {
    let mut boxes = Vec::new();
    let needs_test = |entry: &FrontEntry| {
        if stage.settings.cull == Cull::Off {
            return false;
        }
        let hlod = stage.skeleton.hlod(entry.hlod);
        match test_for(hlod, camera, stage.settings.size, &stage.rules) {
            Test::Visible => false,
            Test::Query(query) => {
                boxes.push(query);
                true
            }
        }
    };
    let tested = entries.iter().map(needs_test).collect();
    (tested, boxes)
}

/// How far the front is decided.
struct Progress<'a> {
    entries: &'a [FrontEntry],
    tested: &'a [bool],
    decided: usize,
    answered: usize,
}

impl Progress<'_> {
    /// Takes the next answers; decides every entry before the first that waits for one.
    fn advance(&mut self, answers: &[bool], last: bool) -> Option<Part> {
        let mut answers = answers.iter();
        let mut visible = Vec::new();
        let begin = self.decided;
        while let Some(entry) = self.entries.get(self.decided) {
            let passes = if self.tested[self.decided] {
                let Some(&answer) = answers.next() else { break };
                self.answered += 1;
                answer
            } else {
                true
            };
            if passes {
                visible.push(entry.hlod);
            }
            self.decided += 1;
        }
        assert!(answers.next().is_none(), "no more answers than boxes");
        assert!(!last || self.decided == self.entries.len(), "an answer for each box");
        let through = self.entries[begin..self.decided].last()?.hlod;
        Some(Part { through, visible })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(ids: &[u32]) -> Vec<FrontEntry> {
        ids.iter().map(|&id| FrontEntry { hlod: HlodId(id), level: 0 }).collect()
    }

    fn ids(part: &Part) -> (u32, Vec<u32>) {
        (part.through.0, part.visible.iter().map(|id| id.0).collect())
    }

    #[test]
    fn an_empty_front_has_no_parts() {
        let mut progress = Progress { entries: &[], tested: &[], decided: 0, answered: 0 };
        assert_eq!(progress.advance(&[], true), None);
    }

    #[test]
    fn untested_entries_ride_along_with_the_answers_before_them() {
        let entries = entries(&[2, 3, 5, 8, 9]);
        let tested = [false, true, true, false, true];
        let mut progress = Progress { entries: &entries, tested: &tested, decided: 0, answered: 0 };
        assert_eq!(ids(&progress.advance(&[false], false).unwrap()), (3, vec![2]));
        assert_eq!(progress.advance(&[], false), None);
        assert_eq!(ids(&progress.advance(&[true, false], true).unwrap()), (9, vec![5, 8]));
    }

    #[test]
    #[should_panic(expected = "an answer for each box")]
    fn a_backend_that_owes_an_answer_is_found_out() {
        let entries = entries(&[1]);
        Progress { entries: &entries, tested: &[true], decided: 0, answered: 0 }.advance(&[], true);
    }
}
