//! Levels of detail of one mesh: simplified, and welded first where that is not enough (paper 004,
//! section 2.2.1: disjoint parts are joined, as GAPS does), each with a proven error.

use crate::options::{MAX_MESH_TRIANGLES, Options};
use geometry::hash::FastHash;
use geometry::hausdorff::{Goal, Surface, directed, directed_but};
use geometry::mesh::Mesh;
use geometry::simplify::simplify;
use geometry::weld::{Repeats, Weld, weld};
use std::collections::{HashMap, HashSet};

/// An error of this share of a mesh's diagonal is not seen before the mesh is wider than most
/// screens: up to there a level goes on below its target.
pub(crate) const UNSEEN: f64 = 1.0 / 2048.0;
/// How far it may then go below.
const FAR_BELOW: usize = 8;
/// Last welding distance as a share of the mesh's diagonal: 16 clusters along it.
const LAST_EPSILON: f64 = 1.0 / 16.0;
/// How far simplification may go in a round, in welding distances, before more is welded instead.
const ERROR_PER_EPSILON: f64 = 4.0;
/// Growth of the welding distance from round to round.
const EPSILON_GROWTH: f64 = 4.0;
/// A level is kept only if it has at most this share of the triangles of the one before.
pub(crate) const PAYING_SHARE: f64 = 0.75;
/// A result this much above its target is near enough.
const NEAR_TARGET: f64 = 1.25;
/// A level that errs by more than this share of the mesh's diagonal says nothing about its shape.
const MOST_ERROR: f64 = 0.5;
/// The error need not be known any better than to this share of what the simplifier thinks it is, or
/// of the error that it is added to.
const ENOUGH: f64 = 0.5;
/// Nor any tighter than to this share above what it is at least.
const SLACK: f64 = 0.5;
/// Factor from what the simplifier thinks a texture slides to what counts.
const SLIDING: f64 = 2.0;
/// Cuts that a proof may take, by triangle of both meshes.
const CUTS: usize = 8;
/// A part that vanished is put back where the error would be so many times what the simplifier thinks it
/// is, or so many times the error that it is added to.
const VANISHED: f64 = 3.0;
/// Least growth of an error from one level to the next, so that the order is strict.
pub(crate) const ERROR_GROWTH: f64 = 1.0 + 1.0 / (1 << 20) as f64;

/// One coarser form of a mesh. Its vertices are vertices of that mesh.
#[derive(Debug, Clone)]
pub(crate) struct CoarseMesh {
    pub(crate) mesh: Mesh,
    /// Bound on the two-sided Hausdorff distance to the original surface, mesh units.
    pub(crate) error: f64,
    /// For each vertex, the one of the chain's base in the same place.
    sources: Vec<u32>,
}

/// Why a chain of levels ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// The mesh is small as it is.
    Small,
    /// No form with few enough triangles was found.
    Unpaying,
    /// The only form found errs too much.
    Wrong,
}

/// Where levels are made, and for what.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Setting<'a> {
    pub(crate) options: &'a Options,
    /// Depth of the hlod: vertices with a lesser seam stay.
    pub(crate) depth: u8,
    /// By surface: what becomes of repeated triangles.
    pub(crate) repeats: &'a [Repeats],
}

/// Makes coarser and coarser forms of one mesh.
pub(crate) struct Chain<'a> {
    setting: Setting<'a>,
    base: &'a Mesh,
    /// How far `base` strays from the original.
    base_error: f64,
    base_surface: Surface,
    /// By vertex of the base, the first one in the same place.
    places: Vec<u32>,
    is_textured: bool,
    diagonal: f64,
    /// Distance welded within; 0: only what is in the same place. A coarser level never needs less.
    epsilon: f64,
}

impl<'a> Chain<'a> {
    /// A chain over `base`, which strays by `base_error` from the original surface and whose parts
    /// have been welded within `epsilon` before.
    pub(crate) fn new(base: &'a Mesh, base_error: f64, epsilon: f64, setting: Setting<'a>) -> Self {
        let diagonal = base.bounds().diagonal();
        let places = places(base);
        let base_surface = Surface::with_places(base, &places);
        let is_textured = base.vertices.iter().any(|vertex| vertex.tex_coord != [0.0; 2]);
        Self { setting, base, base_error, base_surface, places, is_textured, diagonal, epsilon }
    }

    /// Distance that parts have been welded within so far.
    pub(crate) fn epsilon(&self) -> f64 {
        self.epsilon
    }

    /// The next level after `last` of this chain, or the first after the base, with about `target`
    /// triangles, or half as many as there are.
    pub(crate) fn next(
        &mut self,
        last: Option<&CoarseMesh>,
        target: Option<usize>,
    ) -> Result<CoarseMesh, End> {
        let (before, finer) = last.map_or((self.base, self.base_error), |l| (&l.mesh, l.error));
        let target = target.unwrap_or(before.triangles.len() / 2);
        if before.triangles.len() <= self.setting.options.level_least_triangles {
            return Err(End::Small);
        }
        let most = (before.triangles.len() as f64 * PAYING_SHARE) as usize;
        let most = most.min(MAX_MESH_TRIANGLES);
        let (mesh, sources, own) = loop {
            let (mut mesh, mut sources, estimate) = self.reduce(before, target);
            if let Some(last) = last {
                sources.iter_mut().for_each(|source| *source = last.sources[*source as usize]);
            }
            if mesh.triangles.is_empty() || mesh.triangles.len() > most {
                return Err(End::Unpaying);
            }
            let mut own = self.measured(&mut mesh, &mut sources, estimate);
            if self.is_textured {
                // A texture that slides is seen as well as a surface that strays, and only the
                // simplifier knows by how much.
                own = own.max(SLIDING * estimate);
            }
            if mesh.triangles.len() <= most {
                break (mesh, sources, own);
            }
            // Too much had to be put back: parts are to be joined, not dropped.
            if !self.weld_farther(mean_edge(before)) {
                return Err(End::Unpaying);
            }
        };
        let error = (self.base_error + own).max(finer * ERROR_GROWTH);
        if own > self.diagonal * MOST_ERROR || !error.is_finite() {
            return Err(End::Wrong);
        }
        Ok(CoarseMesh { mesh, error, sources })
    }

    /// A mesh of about `target` triangles, or as near as the last epsilon gets; for each of its
    /// vertices the one of `mesh` in the same place; and what its deviation from `mesh` is thought to
    /// be.
    fn reduce(&mut self, mesh: &Mesh, target: usize) -> (Mesh, Vec<u32>, f64) {
        let edge = mean_edge(mesh);
        let mut estimate = 0.0;
        let mut best: Option<(Mesh, Vec<u32>)> = None;
        loop {
            let before = best.as_ref().map_or(mesh, |(mesh, _)| mesh);
            let Setting { depth, repeats, .. } = self.setting;
            let welded = weld(before, Weld { epsilon: self.epsilon, depth, repeats });
            let limit = edge.max(self.epsilon * ERROR_PER_EPSILON);
            let mut simplified = simplify(&welded, target, limit);
            let unseen = self.diagonal * UNSEEN - welded.displacement;
            if simplified.triangles.len() <= target && 2.0 * simplified.estimate < unseen {
                simplified = simplify(&welded, target / FAR_BELOW, unseen);
            }
            let held = welded.locked.iter().filter(|&&locked| locked).count();
            let strayed = welded.displacement + simplified.estimate;
            let (coarse, mut sources) = welded.with_triangles(&simplified.triangles, strayed);
            if coarse.triangles.is_empty() {
                break;
            }
            estimate += strayed;
            let enough = ((target as f64 * NEAR_TARGET) as usize).max(2 * held);
            let done = coarse.triangles.len() <= enough;
            if let Some((_, first)) = &best {
                sources.iter_mut().for_each(|source| *source = first[*source as usize]);
            }
            best = Some((coarse, sources));
            if done || !self.weld_farther(edge) {
                break;
            }
        }
        let (mesh, sources) = best.unwrap_or_default();
        (mesh, sources, estimate)
    }

    /// Lets parts farther apart be joined, if they may be.
    fn weld_farther(&mut self, edge: f64) -> bool {
        let last = self.diagonal * LAST_EPSILON;
        let may = self.epsilon < last;
        self.epsilon = (self.epsilon * EPSILON_GROWTH).max(edge * 0.5).min(last);
        may
    }

    /// A bound on the deviation of `mesh` from the base, both ways, after parts of the base that left
    /// nothing near them have been put back into it. `sources` names, for each vertex of `mesh`, the one
    /// of the base in the same place.
    fn measured(&self, mesh: &mut Mesh, sources: &mut Vec<u32>, estimate: f64) -> f64 {
        let goal = Goal {
            enough: estimate.max(self.base_error) * ENOUGH,
            slack: SLACK,
            budget: CUTS * (mesh.triangles.len() + self.base.triangles.len()),
        };
        let tolerable = VANISHED * estimate.max(self.base_error);
        let places_of = |sources: &[u32]| -> Vec<u32> {
            sources.iter().map(|&source| self.places[source as usize]).collect()
        };
        let surface = Surface::with_places(mesh, &places_of(sources));
        let (near, far) = directed_but(self.base, &surface, &self.places, &goal, tolerable);
        let mut forth = near.upper;
        if !far.is_empty() {
            // Only what was far can have come nearer.
            let far: Vec<u32> = far.iter().map(|stray| stray.triangle).collect();
            let (far, far_sources) = part(self.base, &far);
            let restored = restore(mesh, &far, tolerable);
            sources.extend(restored.iter().map(|&vertex| far_sources[vertex as usize]));
            forth = forth.max(directed(&far, &Surface::new(mesh), &goal).upper);
        }
        let goal = Goal { enough: goal.enough.max(forth), ..goal };
        let (back, _) =
            directed_but(mesh, &self.base_surface, &places_of(sources), &goal, f64::INFINITY);
        forth.max(back.upper)
    }
}

/// For each vertex of a mesh the first one in the same place.
fn places(mesh: &Mesh) -> Vec<u32> {
    let mut first: HashMap<(u64, u64, u64), u32, FastHash> =
        HashMap::with_capacity_and_hasher(mesh.vertices.len(), FastHash::default());
    let numbered = mesh.vertices.iter().zip(0..);
    numbered
        .map(|(vertex, number)| {
            // Adding zero makes -0 and 0 the same key.
            let [x, y, z] = vertex.position.to_array().map(|c| (c + 0.0).to_bits());
            *first.entry((x, y, z)).or_insert(number)
        })
        .collect()
}

/// Some triangles of a mesh, with vertices of their own; and which of the mesh's those are.
fn part(mesh: &Mesh, triangles: &[u32]) -> (Mesh, Vec<u32>) {
    let sources: Vec<u32> = triangles.iter().flat_map(|&t| mesh.triangles[t as usize]).collect();
    let part = Mesh {
        vertices: sources.iter().map(|&index| mesh.vertices[index as usize]).collect(),
        triangles: (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
    };
    (part, sources)
}

/// Puts triangles of `far` into `mesh` so that hardly anything of it is farther away than `reach`:
/// all that are large, and of the small ones the largest of each cell half as wide as that. Returns the
/// vertices of `far` that were put in, in their order.
fn restore(mesh: &mut Mesh, far: &Mesh, reach: f64) -> Vec<u32> {
    let mut restored = Vec::new();
    let longest2 = |t: &[u32; 3]| {
        let [a, b, c] = far.corners(*t);
        a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a))
    };
    let cell = reach * 0.5;
    let mut order: Vec<(f64, [u32; 3])> = far.triangles.iter().map(|t| (longest2(t), *t)).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut taken: HashSet<[i64; 3], FastHash> = HashSet::default();
    for (longest2, corners) in order {
        let [a, b, c] = far.corners(corners);
        let place = ((a + b + c) / (3.0 * cell)).floor().to_array().map(|c| c as i64);
        if longest2 > cell * cell || taken.insert(place) {
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend(corners.map(|index| far.vertices[index as usize]));
            mesh.triangles.push([first, first + 1, first + 2]);
            restored.extend(corners);
        }
    }
    restored
}

/// About the length of an edge: the side of a square as large as two triangles of mean area.
fn mean_edge(mesh: &Mesh) -> f64 {
    let area = |t: &[u32; 3]| {
        let [a, b, c] = mesh.corners(*t);
        (b - a).cross(c - a).length()
    };
    (mesh.triangles.iter().map(area).sum::<f64>() / mesh.triangles.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::hausdorff::sampled;
    use geometry::mesh::MeshVertex;
    use glam::{DVec3, Vec3};

    fn flat(positions: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Mesh {
        let vertex = |position| MeshVertex::plain(position, Vec3::Z, [9, 9, 9, 255]);
        Mesh { vertices: positions.into_iter().map(vertex).collect(), triangles }
    }

    /// Quads in a square grid that do not share vertices and leave gaps between them.
    fn quads(side: u32, gap: f64) -> Mesh {
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for i in 0..side * side {
            let corner = DVec3::new(f64::from(i % side), f64::from(i / side), 0.0);
            let size = 1.0 - gap;
            positions.extend([
                corner,
                corner + DVec3::X * size,
                corner + DVec3::Y * size,
                corner + (DVec3::X + DVec3::Y) * size,
            ]);
            let first = 4 * i;
            triangles.extend([[first, first + 1, first + 2], [first + 1, first + 3, first + 2]]);
        }
        flat(positions, triangles)
    }

    fn area(mesh: &Mesh) -> f64 {
        let of = |t: &[u32; 3]| {
            let [a, b, c] = mesh.corners(*t);
            (b - a).cross(c - a).length() * 0.5
        };
        mesh.triangles.iter().map(of).sum()
    }

    /// All levels of a mesh, each half of the one before.
    fn levels(mesh: &Mesh, error: f64) -> (Vec<CoarseMesh>, End) {
        let options = Options::default();
        let setting = Setting { options: &options, depth: 0, repeats: &[] };
        let mut chain = Chain::new(mesh, error, 0.0, setting);
        let mut levels: Vec<CoarseMesh> = Vec::new();
        loop {
            match chain.next(levels.last(), None) {
                Ok(level) => levels.push(level),
                Err(end) => return (levels, end),
            }
        }
    }

    #[test]
    fn nothing_and_little_have_no_levels() {
        assert!(matches!(levels(&quads(2, 0.1), 0.1), (none, End::Small) if none.is_empty()));
        let heap = flat(
            vec![DVec3::splat(1e7); 60],
            (0..20).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        );
        assert!(matches!(levels(&heap, 0.1), (none, End::Unpaying) if none.is_empty()));
    }

    #[test]
    fn nearly_touching_quads_become_few_and_keep_their_area() {
        let (levels, _) = levels(&quads(40, 0.01), 1e-6);
        let last = levels.last().unwrap();
        assert!(last.mesh.triangles.len() <= 32, "{}", last.mesh.triangles.len());
        for level in &levels {
            assert!((area(&level.mesh) / 1600.0 - 1.0).abs() < 0.1, "{}", area(&level.mesh));
        }
    }

    #[test]
    fn errors_bound_what_is_sampled_and_grow_strictly() {
        let mesh = quads(40, 0.5);
        let original = Surface::new(&mesh);
        let (levels, _) = levels(&mesh, 1e-6);
        assert!(!levels.is_empty());
        assert!(levels.windows(2).all(|w| w[0].error < w[1].error));
        for level in &levels {
            let seen = sampled(&level.mesh, &original, 8).max(sampled(
                &mesh,
                &Surface::new(&level.mesh),
                8,
            ));
            assert!(seen <= level.error, "{seen} > {}", level.error);
        }
    }

    #[test]
    fn a_small_part_far_from_the_rest_is_put_back() {
        let mut mesh = quads(30, 0.0);
        let mut bolt = quads(3, 0.0);
        bolt.vertices.iter_mut().for_each(|v| v.position = v.position * 0.001 + DVec3::Z * 9.0);
        mesh.append(&bolt);
        let (levels, _) = levels(&mesh, 1e-6);
        assert!(!levels.is_empty());
        for level in &levels {
            assert!(level.error < 4.0, "{}", level.error);
            assert!(level.mesh.vertices.iter().any(|v| v.position.z > 8.0));
        }
    }
}
