//! A surface to measure distances to: triangles prepared for it, and a search tree over them.

use super::fans::Fans;
use super::tree::Tree;
use super::triangle::Triangle;
use crate::bounds::Aabb;
use crate::mesh::Mesh;
use glam::DVec3;

/// A surface to measure distances to: a search tree over triangles.
#[derive(Debug, Clone)]
pub struct Surface {
    /// What all coordinates are relative to.
    pub(super) origin: DVec3,
    /// Greatest distance of a corner from the origin.
    pub(super) reach: f64,
    pub(super) triangles: Vec<Triangle>,
    /// Which triangles meet where.
    pub(super) fans: Fans,
    tree: Tree,
}

impl Surface {
    /// Prepares a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        Self::of_triangles(mesh.triangles.iter().map(|t| mesh.corners(*t)))
    }

    /// Prepares a mesh whose vertex `v` lies in the place `places[v]`, a small number: a measurement
    /// that knows the places of its own vertices, too, searches less.
    pub fn with_places(mesh: &Mesh, places: &[u32]) -> Self {
        let (mut surface, order) = Self::sorted(mesh.triangles.iter().map(|t| mesh.corners(*t)));
        let triangles = order.iter().map(|&number| mesh.triangles[number as usize]);
        let corners = triangles.map(|t| t.map(|vertex| places[vertex as usize])).collect();
        surface.fans = Fans::new(corners);
        surface
    }

    /// Prepares loose triangles with finite corners. Of none everything is infinitely far.
    pub fn of_triangles(corners: impl Iterator<Item = [DVec3; 3]> + Clone) -> Self {
        Self::sorted(corners).0
    }

    /// The same, with the numbers of the triangles in the order that they have here.
    fn sorted(corners: impl Iterator<Item = [DVec3; 3]> + Clone) -> (Self, Vec<u32>) {
        let bounds = Aabb::of(corners.clone().flatten());
        let origin = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
        let mut reach2 = 0.0f64;
        let unsorted: Vec<Triangle> = corners
            .map(|triangle| {
                let local = triangle.map(|corner| corner - origin);
                reach2 = local.iter().fold(reach2, |most, p| most.max(p.length_squared()));
                Triangle::new(local)
            })
            .collect();
        let reach = reach2.sqrt();
        let (tree, order) = Tree::new(&unsorted, reach);
        let triangles = order.iter().map(|&number| unsorted[number as usize]).collect();
        (Self { origin, reach, triangles, fans: Fans::default(), tree }, order)
    }

    /// Bytes it takes in memory.
    pub fn bytes(&self) -> usize {
        self.triangles.capacity() * size_of::<Triangle>() + self.fans.bytes() + self.tree.bytes()
    }

    /// Distance from `p` to the nearest triangle, or to any that is at most `enough` away; infinite
    /// when there is none. `hint` names a triangle to try first, and afterwards the one found; 0
    /// will do.
    pub fn distance(&self, p: DVec3, enough: f64, hint: &mut u32) -> f64 {
        let local = p - self.origin;
        *hint = (*hint).min(self.triangles.len().saturating_sub(1) as u32);
        self.nearest2(local, enough * enough, hint).sqrt()
    }

    /// The same, off by roundings of lengths alone even where triangles are slim, which takes longer:
    /// [`Surface::distance`] may find too much there.
    pub fn exact_distance(&self, p: DVec3, enough: f64, hint: &mut u32) -> f64 {
        let local = p - self.origin;
        *hint = (*hint).min(self.triangles.len().saturating_sub(1) as u32);
        self.nearest2_by(Triangle::exact_distance2, local, enough * enough, hint).sqrt()
    }

    /// [`Surface::distance`], squared, from a point relative to the origin.
    pub(super) fn nearest2(&self, p: DVec3, enough: f64, hint: &mut u32) -> f64 {
        self.nearest2_by(Triangle::distance2, p, enough, hint)
    }

    #[inline]
    fn nearest2_by(
        &self,
        distance2: impl Fn(&Triangle, DVec3) -> f64,
        p: DVec3,
        enough: f64,
        hint: &mut u32,
    ) -> f64 {
        let Some(first) = self.triangles.get(*hint as usize) else { return f64::INFINITY };
        let mut best = distance2(first, p);
        if best <= enough {
            return best;
        }
        self.tree.search(p.as_vec3a(), best, |id| {
            let distance = distance2(&self.triangles[id as usize], p);
            if distance < best {
                (best, *hint) = (distance, id);
            }
            if best <= enough { -1.0 } else { best }
        });
        best
    }
}
