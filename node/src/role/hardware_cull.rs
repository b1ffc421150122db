//! HC(i): V_i, the part of the front F_i that passes against the depth of OR(i) (Manocha, sections 4.2 and
//! 4.4).
//!
//! The boxes of the front are tested. Where much of what passes is no part of that depth, since the view has changed
//! or has come out of a wall, a **second look** draws that part to the depth and tests again all that has
//! passed; what no box can tell of (`scene::occludee`) is tested by its own triangles. Both rest on the same
//! proof: whatever of the frame's own front is drawn may hide.

use super::{RoleError, Stage};
use crate::resident::Needs;
use protocol::camera::Camera;
use protocol::id::HlodId;
use protocol::settings::{Cull, Residency as Promise};
use protocol::telemetry::CullCounts;
use scene::backend::{BoxQuery, Completion, Draw, Draws, Pass};
use scene::draw_list::draw_list;
use scene::front::FrontEntry;
use scene::occludee::{BoxTest, BoxTests};

/// A second look is taken where more than one of so many that pass are no occluders, or were not tested: so the
/// want of occluders adds no more than this share to what is drawn.
const SECOND_LOOK: usize = 8;

/// What HC(i) has found.
pub(crate) struct Culled {
    /// V_i, sorted.
    pub(crate) visible: Vec<HlodId>,
    /// What the wire makes of it is counted elsewhere: `changed`, `ids_delta` and `ids_full` are 0.
    pub(crate) counts: CullCounts,
}

/// Finds V_i.
pub(crate) fn run(stage: &mut Stage<'_>, camera: &Camera) -> Result<Culled, RoleError> {
    let front = stage.front(camera);
    let mut counts = CullCounts {
        in_frustum: front.entries.len() as u32,
        source_triangles_in_frustum: front.source_triangles_in_frustum,
        ..CullCounts::default()
    };

    let mut passed = candidates(stage, camera, &front.entries);
    if stage.settings.cull != Cull::Off {
        retain_passing(stage, camera, &mut passed, &mut counts)?;
        second_look(stage, camera, &mut passed, &mut counts)?;
    }

    let untested = |reason| passed.iter().filter(|one| one.test == reason).count() as u32;
    counts.at_eye = untested(Test::AtEye);
    counts.untested = untested(Test::Unproven);
    counts.visible = passed.len() as u32;
    Ok(Culled { visible: passed.iter().map(|one| one.entry.hlod).collect(), counts })
}

/// An entry of the front that may be visible.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Candidate {
    entry: FrontEntry,
    test: Test,
}

/// What may still show that it is hidden.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Test {
    /// Its box.
    Box(BoxQuery),
    /// Its triangles, the eye being in its box or by it.
    AtEye,
    /// Its triangles, for another reason.
    Unproven,
    /// Its triangles have passed.
    Passed,
}

/// All of the front that the picture may show, in its order. Without culling nothing is to be tested.
fn candidates(stage: &Stage<'_>, camera: &Camera, entries: &[FrontEntry]) -> Vec<Candidate> {
    let (size, precision) = (stage.settings.size, stage.backend.precision());
    let tests = BoxTests::new(camera, size, precision, stage.rules);

    let candidate = |&entry: &FrontEntry| {
        let hlod = stage.skeleton.hlod(entry.hlod);
        let test = match stage.settings.cull {
            Cull::Off => Test::Unproven,
            _ => match tests.test(hlod, stage.skeleton.longest_edge(hlod)) {
                BoxTest::AtEye => Test::AtEye,
                BoxTest::Unproven => Test::Unproven,
                BoxTest::Query(query) => Test::Box(query),
                BoxTest::Outside => return None,
            },
        };
        Some(Candidate { entry, test })
    };
    entries.iter().filter_map(candidate).collect()
}

/// Leaves out what has a box that does not pass against the depth there is.
fn retain_passing(
    stage: &mut Stage<'_>,
    camera: &Camera,
    candidates: &mut Vec<Candidate>,
    counts: &mut CullCounts,
) -> Result<(), RoleError> {
    let query = |one: &Candidate| match one.test {
        Test::Box(query) => Some(query),
        _ => None,
    };
    let boxes: Vec<BoxQuery> = candidates.iter().filter_map(query).collect();
    counts.queries += boxes.len() as u32;

    let (view, method) = (stage.view(camera), stage.settings.cull);
    let answers = answers(stage, Pass::QueryBoxes { view, boxes, method })?;
    let mut answers = answers.into_iter();
    candidates.retain(|one| {
        let is_tested = matches!(one.test, Test::Box(_));
        !is_tested || answers.next().expect("an answer for each box")
    });
    Ok(())
}

/// Draws what has passed and is no occluder yet, and tests again.
fn second_look(
    stage: &mut Stage<'_>,
    camera: &Camera,
    passed: &mut Vec<Candidate>,
    counts: &mut CullCounts,
) -> Result<(), RoleError> {
    let is_drawn = |one: &Candidate| stage.occluders.binary_search(&one.entry.hlod).is_ok();
    let is_tested = |one: &Candidate| matches!(one.test, Test::Box(_));
    let unsettled = passed.iter().filter(|one| !is_drawn(one) || !is_tested(one)).count();
    if unsettled * SECOND_LOOK <= passed.len() {
        return Ok(());
    }

    // What hides must be drawn in every picture that is mixed into the one.
    let cells = stage.cells();
    let mixed = cells.compositions(camera.eye);
    let hides = |one: &&Candidate| mixed.iter().all(|of| of.has(one.entry.hlod)) && !is_drawn(one);
    let fresh: Vec<FrontEntry> = passed.iter().filter(hides).map(|one| one.entry).collect();
    add_occluders(stage, camera, fresh, counts)?;

    retain_passing(stage, camera, passed, counts)?;
    test_by_triangles(stage, camera, passed, counts)
}

/// Draws more occluders; what is not there is left out.
fn add_occluders(
    stage: &mut Stage<'_>,
    camera: &Camera,
    mut fresh: Vec<FrontEntry>,
    counts: &mut CullCounts,
) -> Result<(), RoleError> {
    stage.begin_drawing()?;
    let promise = stage.settings.residency;
    loop {
        fresh.retain(|entry| stage.loader.offers_level(entry.level, promise, Needs::Shape));
        let draws = draw_list(&stage.skeleton, &fresh, camera.eye);
        let pass = |view, draws: Draws, part| Pass::Occluders {
            view,
            draws: draws.solid,
            adds: true,
            part,
        };
        // None where a mesh turned out to be unreadable: some of them are drawn, which does no harm.
        let draws = Draws { blending: vec![], ..draws };
        if stage.draw_list(camera, &draws, Needs::Shape, pass)?.is_some() {
            counts.triangles += stage.triangles(&fresh);
            return Ok(());
        }
    }
}

/// Leaves out what no box can tell of and none of whose triangles passes, of all that is there.
fn test_by_triangles(
    stage: &mut Stage<'_>,
    camera: &Camera,
    passed: &mut Vec<Candidate>,
    counts: &mut CullCounts,
) -> Result<(), RoleError> {
    let is_asked = |one: &Candidate| {
        matches!(one.test, Test::AtEye | Test::Unproven)
            && stage.loader.offers_level(one.entry.level, Promise::Deadline, Needs::Shape)
    };
    let asked: Vec<FrontEntry> =
        passed.iter().filter(|one| is_asked(one)).map(|one| one.entry).collect();
    let draws = by_item(draw_list(&stage.skeleton, &asked, camera.eye));
    counts.mesh_queries += asked.len() as u32;

    let view = stage.view(camera);
    let answers = answers(stage, Pass::QueryMeshes { view, draws })?;
    let mut answers = asked.iter().zip(answers).peekable();
    passed.retain_mut(|one| match answers.next_if(|(entry, _)| **entry == one.entry) {
        Some((_, passes)) => {
            one.test = Test::Passed;
            passes
        }
        None => true,
    });
    Ok(())
}

/// Every draw once, those of an item side by side, items in order.
fn by_item(Draws { solid, blending }: Draws) -> Vec<Draw> {
    let mut draws = [solid, blending].concat();
    draws.sort_by_key(|draw| (draw.item, draw.blob));
    draws
}

/// The answers of a pass that tests, in order.
fn answers(stage: &mut Stage<'_>, pass: Pass) -> Result<Vec<bool>, RoleError> {
    let submitted = stage.backend.submit(pass)?;
    let (mut answers, mut completions) = (Vec::new(), Vec::new());
    loop {
        stage.backend.poll(&mut completions)?;
        for completion in completions.drain(..) {
            let Completion::Boxes { ticket, first, visible, last } = completion else {
                unreachable!("what is tested answers as such")
            };
            assert_eq!((ticket, first), (submitted, answers.len()), "answers come in order");
            answers.extend(visible);
            if last {
                return Ok(answers);
            }
        }
    }
}
