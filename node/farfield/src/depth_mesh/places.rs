//! Vertices by the pixel they lie in.

use geometry::mesh::MeshVertex;
use glam::DVec3;

/// Vertices of a face by the pixel they lie in.
pub struct Places<'a> {
    vertices: &'a [MeshVertex],
    /// Pixels a side, and one more for what lies on the border.
    across: usize,
    /// By pixel, where its vertices start in `order`; then the end of the last.
    starts: Vec<u32>,
    order: Vec<u32>,
}

impl<'a> Places<'a> {
    /// Sorts vertices at `(u, v, w)` of a face of `side` pixels.
    pub fn new(vertices: &'a [MeshVertex], side: u32) -> Self {
        let across = side as usize + 1;
        let pixel = |vertex: &MeshVertex| {
            let [u, v, _] = vertex.position.to_array();
            v as usize * across + u as usize
        };
        let mut starts = vec![0; across * across + 1];
        vertices.iter().for_each(|vertex| starts[pixel(vertex) + 1] += 1);
        (1..starts.len()).for_each(|at| starts[at] += starts[at - 1]);
        let mut order: Vec<u32> = (0..vertices.len() as u32).collect();
        order.sort_by_key(|&vertex| pixel(&vertices[vertex as usize]));
        Self { vertices, across, starts, order }
    }

    /// The vertices that are at most `distance` away from a point.
    pub fn near(&self, at: DVec3, distance: f64) -> impl Iterator<Item = u32> {
        let range = |c: f64| {
            let end = (c + distance).floor() + 1.0;
            (c - distance).max(0.0) as usize..(end.max(0.0) as usize).min(self.across)
        };
        let columns = range(at.x);
        let row = move |y: usize| {
            let starts = &self.starts[y * self.across..];
            let end = columns.end.max(columns.start);
            &self.order[starts[columns.start.min(end)] as usize..starts[end] as usize]
        };
        range(at.y)
            .flat_map(row)
            .copied()
            .filter(move |&vertex| self.vertices[vertex as usize].position.distance(at) <= distance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use rand::{Rng, SeedableRng, rngs::StdRng};

    #[test]
    fn as_many_as_a_look_at_all_of_them_finds() {
        let mut rng = StdRng::seed_from_u64(1);
        let vertices: Vec<MeshVertex> = (0..300)
            .map(|_| {
                let [u, v] = [0; 2].map(|_| f64::from(rng.random_range(0..=8)));
                let place = DVec3::new(u, v, rng.random_range(0.0..4.0));
                MeshVertex::plain(place, Vec3::Z, [0; 4])
            })
            .collect();
        let places = Places::new(&vertices, 8);
        for distance in [-1.0, 0.0, 0.4, 1.0, 3.7, 99.0] {
            for _ in 0..50 {
                let at = DVec3::from_array([0; 3].map(|_| rng.random_range(-3.0..11.0)));
                let mut found: Vec<u32> = places.near(at, distance).collect();
                found.sort_unstable();
                let is_near = |v: &u32| vertices[*v as usize].position.distance(at) <= distance;
                assert_eq!(found, (0..300).filter(is_near).collect::<Vec<_>>(), "{at} {distance}");
            }
        }
    }
}
