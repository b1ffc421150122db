//! A city of as many plain boxes as are asked for: streets, blocks of lots, on each lot a building.

use super::builder::Builder;
use super::city::{COLORS, FACADE_COLORS};
use super::random::Random;
use super::{Mesh, Model, Node, materials};
use glam::DVec3;

/// Lots along a block's side.
const LOTS: u32 = 6;
/// Most buildings of a city.
pub const MAX_BUILDINGS: u32 = 2_000_000;

/// Generates `buildings` (at least 1, at most [`MAX_BUILDINGS`]) boxes of 12 triangles, each a mesh of its
/// own, on a square from the origin to `extent` metres along x and z. Streets are as wide as a lot,
/// low houses surround a middle of towers.
///
/// The same arguments give the same model on every machine.
pub fn sprawl(buildings: u32, extent: f64, seed: u64) -> Model {
    let buildings = buildings.clamp(1, MAX_BUILDINGS);
    let rows = least_root(buildings);
    // Streets between the blocks and around the city.
    let lot = extent / f64::from(rows + rows.div_ceil(LOTS) + 1);
    let mut random = Random::new(seed);
    let mut model = Model { materials: materials(&COLORS), ..Model::default() };
    for building in 0..buildings {
        let at = |i: u32| lot * f64::from(i + i / LOTS + 1);
        let (column, row) = (building % rows, building / rows);
        let low = DVec3::new(at(column), 0.0, at(row));
        let size = DVec3::new(random.between(0.5, 0.95), 0.0, random.between(0.5, 0.95)) * lot;
        let aside = DVec3::new(random.unit(), 0.0, random.unit()) * (DVec3::splat(lot) - size);
        let foot = low + DVec3::new(aside.x, 0.0, aside.z);
        // 1 in the middle of the city, 0 at its corners.
        let middle = 0.5 * f64::from(rows);
        let off = |i: u32| (f64::from(i) + 0.5 - middle).abs() / middle;
        let central = 1.0 - off(column).max(off(row));
        let tower = random.chance(0.3 * central * central);
        let storeys = random.between(0.4, 1.6) * (1.0 + central);
        let height = lot * storeys * if tower { random.between(2.0, 5.0) } else { 1.0 };
        let color = FACADE_COLORS.start + random.below(FACADE_COLORS.len() as u32);
        let mut builder = Builder::meshing(1.0, 0);
        builder.cuboid(foot, foot + DVec3::new(size.x, height, size.z));
        let surface = builder.finish();
        let name = format!("building-{building}");
        model.nodes.push(Node { name: name.clone(), mesh: building as usize, matrix: None });
        model.meshes.push(Mesh {
            name,
            material: color as usize,
            positions: surface.positions,
            normals: surface.normals,
            indices: surface.indices,
        });
    }
    model
}

/// The least number whose square is not below `n`.
fn least_root(n: u32) -> u32 {
    let root = n.isqrt();
    if root * root < n { root + 1 } else { root }
}
