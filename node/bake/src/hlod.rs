//! The tree bottom up: levels for every leaf, and for every inner hlod stand-ins for all below it
//! (paper 004, section 2.2.1).
//!
//! Only an hlod, its children's forms and the packed bytes of its subtree are in memory.

use crate::built::{Built, Form, Geometry, PendingLevel, PendingPart, Shape, Subtree, Top};
use crate::levels::{Chain, CoarseMesh, ERROR_GROWTH, End, PAYING_SHARE, Setting, UNSEEN};
use crate::options::{MAX_MESH_TRIANGLES, Options};
use crate::pack::{finest_step, pack, snap};
use crate::pieces::PieceMesh;
use crate::plan::{Member, Pieces, Plan};
use crate::shared::{SharedLevel, SharedLevels};
use crate::source;
use crate::spool::Scene;
use crate::work::{Records, WorkError};
use geometry::bounds::Aabb;
use geometry::hausdorff::{Goal, Surface, directed};
use geometry::hierarchy::Tree;
use geometry::mesh::{Mesh, largest_stretch};
use geometry::weld::Repeats;
use glam::DVec3;
use protocol::format::NONE;
use protocol::format::vertex::{MAX_BLOB_VERTICES, POSITION_MAX};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// A child is put into its parent's mesh with at least so many times the triangles that will be left
/// of it there, unless it errs too little to be seen in the parent.
const SURPLUS: f64 = 1.5;
/// A child whose coarsest level errs by less than this share of what its parent's finest does is
/// given more levels: nothing else stands for it in between.
const GAP: f64 = 0.25;
/// Instances stand for an hlod where they have at most so many times the triangles of one mesh,
const INSTANCES_PAY: f64 = 1.5;
/// and at most so many parts.
const MOST_PARTS: usize = 64;
/// An inner hlod that found no stand-in is built upon as it is up to so many triangles.
const MOST_CARRIED: usize = 8 * MAX_MESH_TRIANGLES;
/// How well the distance is known from what a coarser grid flattened to what is left: to this share
/// above what it is at least,
const FLAT_SLACK: f64 = 0.25;
/// with so many cuts by triangle.
const FLAT_CUTS: usize = 8;
/// Why packing a coarser level cannot fail: triangles without an area were left out of it.
const HAS_AREA: &str = "a coarser level has triangles with an area";

/// What was done and what was skipped, and how long it took: sums over all threads.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    pub(crate) leaf_ns: AtomicU64,
    pub(crate) inner_ns: AtomicU64,
    /// Chains that ended because no form with few enough triangles was found.
    pub(crate) unpaying: AtomicU64,
    /// Levels rejected because they erred too much.
    pub(crate) wrong: AtomicU64,
    /// Levels that a stand-in made needless.
    pub(crate) needless: AtomicU64,
    /// Levels of inner hlods that are instances of their children's.
    pub(crate) instanced: AtomicU64,
    /// Inner hlods without a stand-in.
    pub(crate) bare: AtomicU64,
}

impl Tally {
    fn ended(&self, end: End) {
        match end {
            End::Small => {}
            End::Unpaying => drop(self.unpaying.fetch_add(1, Ordering::Relaxed)),
            End::Wrong => drop(self.wrong.fetch_add(1, Ordering::Relaxed)),
        }
    }
}

/// Everything a subtree is built from.
pub(crate) struct Builder<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) pieces: &'a Pieces,
    pub(crate) piece_file: &'a Records,
    pub(crate) plan: &'a Plan,
    pub(crate) shared: &'a SharedLevels<'a>,
    pub(crate) repeats: &'a [Repeats],
    pub(crate) options: &'a Options,
    pub(crate) tally: Tally,
}

impl Builder<'_> {
    fn tree(&self) -> &Tree {
        &self.plan.tree
    }

    fn surfaces(&self) -> &[source::Surface] {
        &self.scene.surfaces
    }

    fn setting(&self, node: u32) -> Setting<'_> {
        Setting {
            options: self.options,
            depth: self.plan.depths[node as usize],
            repeats: self.repeats,
        }
    }

    /// Builds everything from `node` down.
    pub(crate) fn subtree(&self, node: u32) -> Result<Subtree, WorkError> {
        if let Some(item) = self.tree().nodes[node as usize].item {
            let start = Instant::now();
            let top = self.leaf(node, self.plan.leaves[item as usize].clone())?;
            let spent = start.elapsed().as_nanos() as u64;
            self.tally.leaf_ns.fetch_add(spent, Ordering::Relaxed);
            return Ok(Subtree { top, below: Vec::new() });
        }
        let children: Vec<Subtree> = self
            .tree()
            .children(node)
            .into_par_iter()
            .map(|child| self.subtree(child))
            .collect::<Result<_, _>>()?;
        let mut below = Vec::new();
        let mut tops = Vec::with_capacity(children.len());
        for child in children {
            below.extend(child.below);
            tops.push(child.top);
        }
        let top = self.inner(node, &mut tops)?;
        below.extend(tops.into_iter().map(|child| child.built));
        Ok(Subtree { top, below })
    }

    /// A leaf: pieces of its own as one mesh, or shared pieces as they stand.
    fn leaf(&self, node: u32, members: Range<usize>) -> Result<Top, WorkError> {
        let own = &self.plan.members[members.clone()];
        let one_object = own.windows(2).all(|pair| pair[0].object == pair[1].object);
        let sources = own.iter().map(|m| self.pieces.infos[m.piece as usize].source_triangles);
        let built = Built {
            node,
            levels: Vec::new(),
            bounds: Aabb::EMPTY,
            source_triangles: sources.sum(),
            object: if one_object { own[0].object } else { NONE },
        };
        if own[0].transform == NONE {
            self.whole(built, own)
        } else {
            self.assembly(built, members)
        }
    }

    /// A leaf without shared pieces: a mesh, as few as grid and 16-bit indices allow, and one coarser
    /// level for now.
    fn whole(&self, mut built: Built, members: &[Member]) -> Result<Top, WorkError> {
        let mut parts = Vec::new();
        let mut base = Mesh::default();
        let mut step = f64::INFINITY;
        let mut error = 0.0f64;
        for (group, group_step) in self.groups(members) {
            let mut mesh = Mesh::default();
            for member in group {
                mesh.append(&self.piece(member)?.mesh(|other| self.meeting_depth(member, other)));
                error = error.max(self.pieces.infos[member.piece as usize].error);
            }
            let packed = pack(&mesh, group_step, self.surfaces());
            let packed = packed.expect("pieces without an area were left out");
            parts.push(PendingPart { geometry: Geometry::Packed(packed), transform: NONE });
            step = step.min(group_step);
            base.append(&mesh);
        }
        built.bounds = base.bounds();
        let triangles = parts.iter().map(part_triangles).sum();
        built.levels.push(PendingLevel { error, triangles, parts });
        let step = fitting_step(&base, step);
        let moved = coarsen(&mut base, step);
        built.bounds = built.bounds.union(base.bounds());
        let form = Form {
            error: error + moved,
            triangles: base.triangles.len(),
            shape: Shape::Mesh(base),
        };
        let forms = if moved.is_finite() { vec![form] } else { Vec::new() };
        let mut top = Top { built, forms, step, epsilon: 0.0, worst: error };
        self.extend(&mut top, f64::INFINITY, 1);
        Ok(top)
    }

    /// Runs of members that fit one blob, each with its grid step.
    fn groups<'m>(&self, members: &'m [Member]) -> Vec<(&'m [Member], f64)> {
        let mut groups: Vec<(Range<usize>, Aabb, f64, usize)> = Vec::new();
        for (i, member) in members.iter().enumerate() {
            let info = &self.pieces.infos[member.piece as usize];
            let vertices = info.vertices as usize;
            if let Some((range, bounds, step, count)) = groups.last_mut() {
                let (joined, finer) = (bounds.union(info.bounds), step.min(info.step));
                let fits = joined.extent().max_element() / finer < f64::from(POSITION_MAX - 1);
                if fits && *count + vertices <= MAX_BLOB_VERTICES {
                    (range.end, *bounds, *step, *count) = (i + 1, joined, finer, *count + vertices);
                    continue;
                }
            }
            groups.push((i..i + 1, info.bounds, info.step, vertices));
        }
        groups.into_iter().map(|(range, _, step, _)| (&members[range], step)).collect()
    }

    fn piece(&self, member: &Member) -> Result<PieceMesh, WorkError> {
        self.pieces.read(self.piece_file, member.piece as usize)
    }

    fn meeting_depth(&self, member: &Member, other: u32) -> u8 {
        self.plan.meeting_depth(member, other, self.pieces)
    }

    /// A leaf that shows shared pieces: its levels are put together from theirs.
    fn assembly(&self, mut built: Built, members: Range<usize>) -> Result<Top, WorkError> {
        let errors_of = |m: usize| {
            let member = &self.plan.members[m];
            let linear = &self.scene.objects[member.object as usize].world_from_mesh.matrix3;
            let stretch = largest_stretch(linear);
            self.shared.levels(member.piece as usize).iter().map(move |l| l.error * stretch)
        };
        let mut errors: Vec<f64> = members.clone().flat_map(errors_of).collect();
        errors.sort_by(f64::total_cmp);
        let finest = members.clone().filter_map(|m| errors_of(m).next()).fold(0.0, f64::max);
        let mut forms: Vec<Form> = Vec::new();
        // At each error some part may go coarser.
        for error in errors.into_iter().filter(|&error| error >= finest) {
            let level_of = |m: usize| errors_of(m).take_while(|&own| own <= error).count() - 1;
            let form = self.form_of(members.clone().map(|m| [m as u32, level_of(m) as u32]), error);
            let most = forms.last().map(|f| (f.triangles as f64 * PAYING_SHARE) as usize);
            if most.is_none_or(|most| form.triangles <= most) {
                forms.push(form);
            }
        }
        // Coarser levels have no vertices that the finest has not. A reader places them by this sum.
        for member in &self.plan.members[members] {
            let transform = self.plan.transforms[member.transform as usize];
            let piece = self.piece(member)?;
            let placed = piece.vertices.iter().map(|v| piece.position(v).to_array());
            let points = placed.map(|p| DVec3::from_array(transform.apply(p)));
            built.bounds = built.bounds.union(Aabb::of(points));
        }
        let mut top = Top { built, forms: Vec::new(), step: 0.0, epsilon: 0.0, worst: 0.0 };
        forms.into_iter().for_each(|form| self.push_parts(&mut top, form));
        Ok(top)
    }

    /// A form put together from levels of shared pieces, its error being `error`.
    fn form_of(&self, parts: impl Iterator<Item = [u32; 2]>, error: f64) -> Form {
        let parts: Vec<[u32; 2]> = parts.collect();
        let triangles = parts.iter().map(|&part| self.shared_level(part).triangles as usize);
        Form { error, triangles: triangles.sum(), shape: Shape::Parts(parts) }
    }

    fn shared_level(&self, [member, level]: [u32; 2]) -> &SharedLevel {
        let piece = self.plan.members[member as usize].piece;
        &self.shared.levels(piece as usize)[level as usize]
    }

    /// Adds a level that is put together from levels of shared pieces.
    fn push_parts(&self, top: &mut Top, form: Form) {
        let Shape::Parts(parts) = &form.shape else { unreachable!("a form of parts") };
        let pending = parts.iter().map(|&part| {
            let member = &self.plan.members[part[0] as usize];
            let linear = &self.scene.objects[member.object as usize].world_from_mesh.matrix3;
            let &SharedLevel { blob, longest_edge, .. } = self.shared_level(part);
            let longest_edge = longest_edge * largest_stretch(linear);
            PendingPart {
                geometry: Geometry::Written { blob, longest_edge },
                transform: member.transform,
            }
        });
        top.built.levels.push(PendingLevel {
            error: form.error,
            triangles: form.triangles as u32,
            parts: pending.collect(),
        });
        top.worst = form.error;
        top.forms.push(form);
    }

    /// The mesh of a form, in the world.
    fn realise(&self, form: &Form) -> Result<Mesh, WorkError> {
        let parts = match &form.shape {
            Shape::Mesh(mesh) => return Ok(mesh.clone()),
            Shape::Parts(parts) => parts,
        };
        let mut mesh = Mesh::default();
        for &[m, level] in parts {
            let member = &self.plan.members[m as usize];
            let piece = self.shared.mesh(member.piece as usize, level as usize)?;
            let part = piece.mesh(|other| self.meeting_depth(member, other));
            let object = &self.scene.objects[member.object as usize];
            mesh.append(&part.placed(&object.world_from_mesh));
        }
        Ok(mesh)
    }

    /// Gives an hlod further levels, at most `most`, as long as the last errs by less than `until`.
    fn extend(&self, top: &mut Top, until: f64, most: usize) {
        let Some(Form { error, shape: Shape::Mesh(last), .. }) = top.forms.last() else { return };
        if *error >= until {
            return;
        }
        let mut chain = Chain::new(last, *error, top.epsilon, self.setting(top.built.node));
        let mut made: Vec<CoarseMesh> = Vec::new();
        while made.len() < most {
            if made.last().is_some_and(|level| level.error >= until) {
                break;
            }
            match chain.next(made.last(), None) {
                Ok(level) => made.push(level),
                Err(end) => {
                    self.tally.ended(end);
                    break;
                }
            }
        }
        top.epsilon = chain.epsilon();
        for level in made {
            self.push(top, level);
        }
    }

    /// Adds a level that was made from the forms before it.
    fn push(&self, top: &mut Top, level: CoarseMesh) {
        let CoarseMesh { mesh, error, .. } = level;
        let packed = pack(&mesh, top.step, self.surfaces()).expect(HAS_AREA);
        let points = packed.positions().map(DVec3::from_array);
        top.built.bounds = top.built.bounds.union(Aabb::of(points));
        let part = PendingPart { geometry: Geometry::Packed(packed), transform: NONE };
        let triangles = part_triangles(&part);
        top.built.levels.push(PendingLevel { error, triangles, parts: vec![part] });
        top.worst = error;
        let triangles = mesh.triangles.len();
        top.forms.push(Form { error, triangles, shape: Shape::Mesh(mesh) });
    }

    /// An inner hlod over `children`, which gain levels where there would be a gap and lose those
    /// that it makes needless.
    pub(crate) fn inner(&self, node: u32, children: &mut [Top]) -> Result<Top, WorkError> {
        let start = Instant::now();
        let built = Built {
            node,
            levels: Vec::new(),
            bounds: children.iter().fold(Aabb::EMPTY, |sum, child| sum.union(child.built.bounds)),
            source_triangles: children.iter().map(|child| child.built.source_triangles).sum(),
            object: NONE,
        };
        let worst = children.iter().map(|child| child.worst).fold(0.0, f64::max);
        let epsilon = children.iter().map(|child| child.epsilon).fold(0.0, f64::max);
        let mut top = Top { built, forms: Vec::new(), step: 0.0, epsilon, worst };
        if children.iter().all(|child| !child.forms.is_empty()) {
            self.stand_in(&mut top, children)?;
        }
        if top.built.levels.is_empty() {
            self.tally.bare.fetch_add(1, Ordering::Relaxed);
            children.iter_mut().for_each(|child| self.extend(child, f64::INFINITY, usize::MAX));
            top.worst = children.iter().map(|child| child.worst).fold(top.worst, f64::max);
            top.forms.iter_mut().for_each(|form| form.error = form.error.max(top.worst));
        } else if node == 0 {
            // Nothing above the root takes over from it.
            self.extend(&mut top, f64::INFINITY, usize::MAX);
        }
        // Children may have grown by levels they were given here.
        let below = children.iter().map(|child| child.built.bounds);
        top.built.bounds = below.fold(top.built.bounds, Aabb::union);
        self.tally.inner_ns.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
        Ok(top)
    }

    /// The levels `made` of an inner hlod, put together from its children's own where those are
    /// instances and hardly more triangles: they cost no bytes.
    fn cheaper_parts(&self, made: &[CoarseMesh], children: &[Top]) -> Option<Vec<Form>> {
        let mut forms: Vec<Form> = Vec::new();
        for level in made {
            let mut parts = Vec::new();
            let mut error = 0.0f64;
            for child in children {
                let fits = |form: &&Form| form.error <= level.error;
                let form = child.forms.iter().rev().find(fits)?;
                let Shape::Parts(own) = &form.shape else { return None };
                error = error.max(form.error);
                parts.extend_from_slice(own);
            }
            let form = self.form_of(parts.into_iter(), error);
            let Shape::Parts(parts) = &form.shape else { return None };
            let most = (level.mesh.triangles.len() as f64 * INSTANCES_PAY) as usize;
            if form.triangles > most || parts.len() > MOST_PARTS {
                break;
            }
            if forms.last().is_none_or(|before| before.triangles > form.triangles) {
                forms.push(form);
            }
        }
        (!forms.is_empty()).then_some(forms)
    }

    /// Drops a child's levels that err as much as the finest of its parent: one level for all
    /// children serves better.
    fn trim(&self, children: &mut [Top], finest: f64) {
        for child in children {
            let before = child.built.levels.len();
            // The original geometry of a leaf stays.
            let is_leaf = self.tree().nodes[child.built.node as usize].item.is_some();
            let mut first = is_leaf;
            let keeps = |level: &PendingLevel| std::mem::take(&mut first) || level.error < finest;
            child.built.levels.retain(keeps);
            let dropped = before - child.built.levels.len();
            self.tally.needless.fetch_add(dropped as u64, Ordering::Relaxed);
        }
    }

    /// Makes the levels of an inner hlod from its children's forms.
    fn stand_in(&self, top: &mut Top, children: &mut [Top]) -> Result<(), WorkError> {
        let total: usize = children.iter().map(|child| child.forms[0].triangles).sum();
        let target = self.options.hlod_triangles.min(total / children.len());
        let unseen = top.built.bounds.diagonal() * UNSEEN;
        let mut merged = Mesh::default();
        let mut error = 0.0f64;
        let mut step = f64::INFINITY;
        for child in children.iter() {
            let share = target as f64 * child.forms[0].triangles as f64 / total.max(1) as f64;
            let least = (SURPLUS * share) as usize;
            let enough = |form: &&Form| form.triangles >= least || form.error <= unseen;
            let form = child.forms.iter().rev().find(enough).unwrap_or(&child.forms[0]);
            error = error.max(form.error);
            step = step.min(child.step);
            merged.append(&self.realise(form)?);
        }
        top.step = fitting_step(&merged, step);
        if top.step != step {
            error += coarsen(&mut merged, top.step);
            if !error.is_finite() {
                return Ok(());
            }
        }
        let target = target.min(merged.triangles.len() / 2);
        let mut chain = Chain::new(&merged, error, top.epsilon, self.setting(top.built.node));
        let mut made: Vec<CoarseMesh> = Vec::new();
        while made.len() < self.options.hlod_levels {
            match chain.next(made.last(), made.is_empty().then_some(target)) {
                Ok(level) => made.push(level),
                Err(end) => {
                    self.tally.ended(end);
                    break;
                }
            }
        }
        top.epsilon = chain.epsilon();
        if made.is_empty() {
            if merged.triangles.len() <= MOST_CARRIED {
                let triangles = merged.triangles.len();
                // Levels made from it later lie on its grid, not on the children's.
                top.built.bounds = top.built.bounds.union(merged.bounds());
                top.forms.push(Form { error, triangles, shape: Shape::Mesh(merged) });
            }
            return Ok(());
        }
        if let Some(forms) = self.cheaper_parts(&made, children) {
            self.tally.instanced.fetch_add(forms.len() as u64, Ordering::Relaxed);
            let finest = forms[0].error;
            top.step = 0.0;
            self.trim(children, finest);
            forms.into_iter().for_each(|form| self.push_parts(top, form));
            return Ok(());
        }
        for child in children.iter_mut().filter(|child| child.worst < made[0].error * GAP) {
            // A level after one that errs half as much would hardly stay below.
            self.extend(child, made[0].error * 0.5, usize::MAX);
        }
        let floor = raise(&mut made, children);
        self.trim(children, floor);
        for level in made {
            self.push(top, level);
        }
        Ok(())
    }
}

fn part_triangles(part: &PendingPart) -> u32 {
    match &part.geometry {
        Geometry::Packed(packed) => packed.triangles(),
        Geometry::Written { .. } => 0,
    }
}

/// The step to pack a mesh on: `step` if it lies on that grid and fits, else the finest that does.
fn fitting_step(mesh: &Mesh, step: f64) -> f64 {
    let bounds = mesh.bounds();
    let farthest = bounds.min.abs().max(bounds.max.abs()).max_element();
    let finest = finest_step(bounds.extent().max_element(), farthest);
    if step.is_finite() { step.max(finest) } else { finest }
}

/// Moves a mesh to a coarser grid and takes out what has no area there. Returns how far the surface is
/// from what it was, either way; infinite if nothing is left of it.
fn coarsen(mesh: &mut Mesh, step: f64) -> f64 {
    let moved = snap(mesh, step);
    let has_area = |t: &[u32; 3]| {
        let [a, b, c] = mesh.corners(*t);
        a != b && b != c && c != a
    };
    let (kept, flat): (Vec<_>, Vec<_>) = mesh.triangles.iter().copied().partition(has_area);
    if flat.is_empty() {
        return moved;
    }
    let budget = FLAT_CUTS * (flat.len() + kept.len());
    mesh.triangles = flat;
    let gone = mesh.clone();
    mesh.triangles = kept;
    let goal = Goal { enough: step, slack: FLAT_SLACK, budget };
    moved + directed(&gone, &Surface::new(mesh), &goal).upper
}

/// Makes errors monotone between an hlod and its children. A child without levels cannot be trimmed,
/// so there this hlod's errors are raised over those below it. Returns the least error of the hlod.
fn raise(made: &mut [CoarseMesh], children: &[Top]) -> f64 {
    let bare = children.iter().filter(|child| child.built.levels.is_empty());
    let floor =
        bare.map(|c| c.worst * ERROR_GROWTH).fold(made[0].error, |floor, worst| floor.max(worst));
    let mut least = floor;
    for level in made.iter_mut() {
        level.error = level.error.max(least);
        least = level.error * ERROR_GROWTH;
    }
    floor
}
