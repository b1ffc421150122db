//! HC(i): V_i, the part of the front F_i that passes against the depth of OR(i) (Manocha, sections 4.2 and
//! 4.4).
//!
//! 1. The boxes of the front are tested.
//! 2. Where much of what passes is no part of that depth, since the view has changed, has come out of a wall, or is
//!    the first, a **second look** draws that part to the depth, the nearest first, and tests what is left, until
//!    all that passes has been drawn.
//! 3. What no box can tell of (`scene::occludee`) is tested by its own triangles. So is a share of the rest, in turn,
//!    for a box may show where what is in it does not; and what was found hidden so, as long as its box passes.
//!
//! All rests on the same proof: whatever of the frame's own front is drawn may hide.

use super::occlusion_representation::{draw_depth, retain_what_hides};
use super::{RoleError, Stage};
use crate::resident::{Drawn, Needs};
use protocol::camera::Camera;
use protocol::format::{Class, Skeleton};
use protocol::id::HlodId;
use protocol::settings::Cull;
use protocol::telemetry::CullCounts;
use scene::backend::{Backend, BoxQuery, Completion, Draw, Draws, Pass};
use scene::draw_list::draw_list;
use scene::front::{FrontEntry, distance_from_eye};
use scene::occludee::{BoxTest, BoxTests};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// A second look is taken where more than one of so many that pass are no occluders: so the want of occluders adds
/// no more than this share to what is drawn.
const SECOND_LOOK: usize = 8;
/// Occluders that a second look draws before it tests again; then twice as many, and so on.
const FIRST_DRAWN: usize = 32;
/// Every hlod that passes is tested by its triangles once in so many frames that are culled here.
const TURNS: u32 = 8;
/// What has a box and is tested by its triangles all the same has this share at most of the triangles that pass.
const SHARE_OF_TRIANGLES: u64 = 8;

/// What HC(i) has found.
pub(crate) struct Culled {
    /// V_i, sorted.
    pub(crate) visible: Vec<HlodId>,
    /// What the wire makes of it is counted elsewhere: `leaving`, `entering` and all `ids_*` are 0.
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
        // Against nothing all pass.
        if !stage.occluders.is_empty() {
            retain_passing(stage, camera, &mut passed, |_| true, &mut counts)?;
        }
        second_look(stage, camera, &mut passed, &mut counts)?;
        test_by_triangles(stage, camera, &mut passed, &mut counts)?;
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
    /// Its triangles alone, the eye being in its box or by it.
    AtEye,
    /// Its triangles alone, for another reason.
    Unproven,
    /// Nothing: its triangles have passed.
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

/// Leaves out what `is_asked` of what has a box, and does not pass against the depth there is.
fn retain_passing(
    stage: &mut Stage<'_>,
    camera: &Camera,
    candidates: &mut Vec<Candidate>,
    is_asked: impl Fn(&Candidate) -> bool,
    counts: &mut CullCounts,
) -> Result<(), RoleError> {
    let query = |one: &Candidate| match one.test {
        Test::Box(query) if is_asked(one) => Some(query),
        _ => None,
    };
    let boxes: Vec<BoxQuery> = candidates.iter().filter_map(query).collect();
    counts.queries += boxes.len() as u32;

    let (view, method) = (stage.view(camera), stage.settings.cull);
    stage.backend.submit(Pass::QueryBoxes { view, boxes, method })?;
    let mut answers = answers(stage)?.into_iter();
    candidates
        .retain(|one| query(one).is_none() || answers.next().expect("an answer for each box"));
    Ok(())
}

/// Draws what has passed and is no occluder yet, the nearest first, and tests again what is left.
fn second_look(
    stage: &mut Stage<'_>,
    camera: &Camera,
    passed: &mut Vec<Candidate>,
    counts: &mut CullCounts,
) -> Result<(), RoleError> {
    let mut drawn: BTreeSet<HlodId> = stage.occluders.iter().copied().collect();
    let entries = passed.iter().map(|one| one.entry);
    let mut fresh: Vec<FrontEntry> = entries.filter(|e| !drawn.contains(&e.hlod)).collect();
    if fresh.len() * SECOND_LOOK <= passed.len() {
        return Ok(());
    }
    retain_what_hides(stage, camera, &mut fresh);
    // None is negative, and so their bits have their order.
    let distance =
        |entry: &FrontEntry| distance_from_eye(stage.skeleton.hlod(entry.hlod), camera.eye);
    fresh.sort_by_cached_key(|entry| (distance(entry).to_bits(), entry.hlod));

    stage.begin_drawing()?;
    let mut most = FIRST_DRAWN;
    while !fresh.is_empty() {
        let nearest: Vec<FrontEntry> = fresh.drain(..most.min(fresh.len())).collect();
        most *= 2;

        drawn.extend(nearest.iter().map(|entry| entry.hlod));
        let nearest = draw_depth(stage, camera, nearest, true)?;
        counts.triangles += stage.triangles(&nearest);
        let is_left = |one: &Candidate| !drawn.contains(&one.entry.hlod);
        retain_passing(stage, camera, passed, is_left, counts)?;
        fresh
            .retain(|entry| passed.binary_search_by_key(&entry.hlod, |one| one.entry.hlod).is_ok());
    }

    // What was drawn early may be hidden by what was drawn late.
    retain_passing(stage, camera, passed, |_| true, counts)
}

/// Leaves out those of what passes whose turn it is, or of which no box can tell, and none of whose triangles passes.
fn test_by_triangles(
    stage: &mut Stage<'_>,
    camera: &Camera,
    passed: &mut Vec<Candidate>,
    counts: &mut CullCounts,
) -> Result<(), RoleError> {
    stage.turn = stage.turn.wrapping_add(1);
    let asked = asked(stage, passed);
    if asked.is_empty() {
        return Ok(());
    }
    counts.mesh_queries += asked.len() as u32;
    counts.triangles += stage.triangles(&asked);

    let shows = items_that_pass(stage, camera, &asked)?;
    let mut asked = asked.iter().peekable();
    passed.retain_mut(|one| {
        if asked.next_if(|entry| **entry == one.entry).is_none() {
            return true;
        }
        let id = one.entry.hlod;
        let Some(&passes) = shows.get(&id) else { return true };
        one.test = Test::Passed;
        match passes {
            true => stage.hidden.remove(&id),
            false => stage.hidden.insert(id),
        };
        passes
    });
    Ok(())
}

/// What of `passed` is tested by its triangles, in the same order.
fn asked(stage: &Stage<'_>, passed: &[Candidate]) -> Vec<FrontEntry> {
    // With a deadline what is not there is not waited for.
    let promise = stage.settings.residency;
    let offered = passed
        .iter()
        .filter(|one| stage.loader.offers_level(one.entry.level, promise, Needs::Shape));
    let (with_boxes, mut asked): (Vec<&Candidate>, Vec<&Candidate>) =
        offered.partition(|one| matches!(one.test, Test::Box(_)));

    // Of those that have a box first what was found hidden, then those whose turn it is, the cheapest first: so most
    // hlods are found hidden for least.
    let triangles = |one: &Candidate| stage.triangles(&[one.entry]);
    let mut left = passed.iter().map(triangles).sum::<u64>() / SHARE_OF_TRIANGLES;
    let is_due = |one: &&&Candidate| {
        let id = one.entry.hlod;
        id.0.wrapping_add(stage.turn).is_multiple_of(TURNS) || stage.hidden.contains(&id)
    };
    let mut due: Vec<&Candidate> = with_boxes.iter().filter(is_due).copied().collect();
    due.sort_by_cached_key(|one| {
        let id = one.entry.hlod;
        (!stage.hidden.contains(&id), triangles(one), id)
    });
    asked.extend(due.into_iter().take_while(|one| {
        let cost = triangles(one);
        let fits = cost <= left;
        left = left.saturating_sub(cost);
        fits
    }));

    let mut asked: Vec<FrontEntry> = asked.into_iter().map(|one| one.entry).collect();
    asked.sort_by_key(|entry| entry.hlod);
    asked
}

/// Whether a triangle of these passes, by hlod; of one that turns out to be unreadable nothing is said.
fn items_that_pass(
    stage: &mut Stage<'_>,
    camera: &Camera,
    asked: &[FrontEntry],
) -> Result<BTreeMap<HlodId, bool>, RoleError> {
    let view = stage.view(camera);
    let draws = draw_list(&stage.skeleton, asked, camera.eye);
    let skeleton = Arc::clone(&stage.skeleton);
    let mut submitted: Vec<Vec<HlodId>> = Vec::new();
    let submit = |backend: &mut dyn Backend, draws: Draws, _| {
        let draws = by_item(&skeleton, draws);
        if !draws.is_empty() {
            submitted.push(draws.chunk_by(|a, b| a.item == b.item).map(|of| of[0].item).collect());
            backend.submit(Pass::QueryMeshes { view, draws })?;
        }
        Ok(())
    };
    let outcome = stage.loader.stream(stage.backend.as_mut(), &draws, Needs::Shape, submit)?;

    // A list that does not fit at once is asked in parts, and so may one hlod be.
    let mut shows: BTreeMap<HlodId, bool> = BTreeMap::new();
    for items in submitted {
        for (item, passes) in items.into_iter().zip(answers(stage)?) {
            *shows.entry(item).or_default() |= passes;
        }
    }
    if outcome == Drawn::Lost {
        shows.retain(|_, passes| *passes);
    }
    Ok(shows)
}

/// Every draw once, those of an item side by side, items in order.
fn by_item(skeleton: &Skeleton, Draws { solid, mut blending }: Draws) -> Vec<Draw> {
    let is_solid = |class: &Class| !class.is_blend();
    let stands_in_both = |draw: &Draw| {
        let blob = skeleton.blob(draw.blob);
        Class::ALL.iter().filter(|class| is_solid(class)).any(|&class| blob.has(class))
    };
    blending.retain(|draw| !stands_in_both(draw));
    let mut draws = [solid, blending].concat();
    draws.sort_by_key(|draw| (draw.item, draw.blob));
    draws
}

/// The answers of the first pass that is not answered, in order.
fn answers(stage: &mut Stage<'_>) -> Result<Vec<bool>, RoleError> {
    let mut answers = Vec::new();
    loop {
        if stage.completions.is_empty() {
            stage.backend.poll(&mut stage.completions)?;
        }
        let Completion::Boxes { first, visible, last, .. } = stage.completions.remove(0) else {
            unreachable!("what is tested answers as such")
        };
        assert_eq!(first, answers.len(), "answers come in order");
        answers.extend(visible);
        if last {
            return Ok(answers);
        }
    }
}
