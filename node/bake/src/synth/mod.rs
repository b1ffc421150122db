//! Seeded generators of test scenes: Y up, metres, one mesh and one node an object.
//!
//! A generator lays out objects as functions that build themselves at a given level of detail. The
//! level that gives the number of triangles asked for is found by bisection over counting runs, then
//! the meshes are made once. The layout depends on the seed alone.

mod builder;
mod city;
mod glb;
mod park;
mod pipes;
mod plant;
mod random;
mod sprawl;
mod town;

pub use glb::{GlbError, write_glb};
pub use sprawl::{MAX_BUILDINGS, sprawl};
pub use town::{Town, TownError, write_town};

use builder::Builder;

/// What to generate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// An 80 m power-plant hall of 1,185 objects, after the UNC power plant of paper 004: one pipe
    /// network that spans the building holds half of all triangles.
    Plant,
    /// A hundred pipe-rack modules, three quarters of them instances of a few meshes, turned, mirrored and stretched.
    Pipes,
    /// 956 distinct statues, each on its plot of a 2400 x 2000 ground (paper 003, section 5).
    Park,
    /// Streets and blocks of houses with facades.
    City,
}

impl Kind {
    /// Triangles of the scene at full size, instances counted each.
    pub fn full_size(self) -> u64 {
        match self {
            Self::Plant => 12_700_000,
            Self::Pipes => 1_000_000,
            Self::Park => 2_270_000,
            Self::City => 2_000_000,
        }
    }
}

impl std::str::FromStr for Kind {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "plant" => Ok(Self::Plant),
            "pipes" => Ok(Self::Pipes),
            "park" => Ok(Self::Park),
            "city" => Ok(Self::City),
            _ => Err(format!("no synthetic scene {name}: plant, pipes, park or city")),
        }
    }
}

/// A colour by name.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// What it is on.
    pub name: String,
    /// Linear RGBA.
    pub base_color: [f32; 4],
}

/// An indexed triangle mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// Name.
    pub name: String,
    /// Index into [`Model::materials`].
    pub material: usize,
    /// Positions, metres.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals, one a position.
    pub normals: Vec<[f32; 3]>,
    /// Three a triangle, counter-clockwise seen from outside.
    pub indices: Vec<u32>,
}

/// An object: a mesh in its place.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    /// Name.
    pub name: String,
    /// Index into [`Model::meshes`].
    pub mesh: usize,
    /// Column-major placement; none is the identity.
    pub matrix: Option<[f64; 16]>,
}

/// A generated scene.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Model {
    /// Colours.
    pub materials: Vec<Material>,
    /// Meshes; shared where several nodes name one.
    pub meshes: Vec<Mesh>,
    /// Objects.
    pub nodes: Vec<Node>,
}

impl Model {
    /// Triangles, instances counted each.
    pub fn triangles(&self) -> u64 {
        self.nodes.iter().map(|n| self.meshes[n.mesh].indices.len() as u64 / 3).sum()
    }
}

/// Most triangles of a generated scene: as many as surely fit the 4 GiB of a GLB.
pub const MAX_TRIANGLES: u64 = 80_000_000;

/// Builds an object's surface.
type Build = Box<dyn Fn(&mut Builder)>;

/// A mesh yet to be built, and where it stands.
struct Object {
    name: String,
    material: usize,
    build: Build,
    /// Column-major; empty stands for one identity.
    placements: Vec<[f64; 16]>,
}

/// Objects that share a level of detail.
struct Group {
    /// Part of the scene's triangles that it is to hold.
    share: f64,
    objects: Vec<Object>,
}

/// A scene before its level of detail is known.
struct Plan {
    materials: Vec<Material>,
    groups: Vec<Group>,
}

/// Names of materials with their linear colours.
fn materials(table: &[(&str, [f32; 3])]) -> Vec<Material> {
    table
        .iter()
        .map(|&(name, [r, g, b])| Material { name: name.to_owned(), base_color: [r, g, b, 1.0] })
        .collect()
}

/// Generates a scene of about `triangles` (none: [`Kind::full_size`]).
///
/// The same arguments give the same model on every machine. The layout does not depend on `triangles`;
/// a request below what the layout needs at its coarsest gives that, and one beyond [`MAX_TRIANGLES`]
/// gives [`MAX_TRIANGLES`].
pub fn generate(kind: Kind, triangles: Option<u64>, seed: u64) -> Model {
    let plan = match kind {
        Kind::Plant => plant::plan(seed),
        Kind::Pipes => pipes::plan(seed),
        Kind::Park => park::plan(seed),
        Kind::City => city::plan(seed),
    };
    let wanted = triangles.unwrap_or(kind.full_size()).min(MAX_TRIANGLES) as f64;
    let mut model = Model { materials: plan.materials, ..Model::default() };
    for (g, group) in plan.groups.iter().enumerate() {
        let group_seed = seed ^ (g as u64 + 1) << 56;
        let detail = fit_detail(&group.objects, group_seed, wanted * group.share);
        for (i, object) in group.objects.iter().enumerate() {
            let mut builder = Builder::meshing(detail, object_seed(group_seed, i));
            (object.build)(&mut builder);
            push_object(&mut model, object, builder);
        }
    }
    model
}

fn push_object(model: &mut Model, object: &Object, builder: Builder) {
    let surface = builder.finish();
    let mesh = model.meshes.len();
    model.meshes.push(Mesh {
        name: object.name.clone(),
        material: object.material,
        positions: surface.positions,
        normals: surface.normals,
        indices: surface.indices,
    });
    if object.placements.is_empty() {
        model.nodes.push(Node { name: object.name.clone(), mesh, matrix: None });
    }
    for (i, &matrix) in object.placements.iter().enumerate() {
        model.nodes.push(Node { name: format!("{}-{i}", object.name), mesh, matrix: Some(matrix) });
    }
}

fn object_seed(group_seed: u64, index: usize) -> u64 {
    group_seed.wrapping_add((index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
}

fn count(objects: &[Object], group_seed: u64, detail: f64) -> u64 {
    let mut sum = 0;
    for (i, object) in objects.iter().enumerate() {
        let mut builder = Builder::counting(detail, object_seed(group_seed, i));
        (object.build)(&mut builder);
        sum += builder.triangles() * object.placements.len().max(1) as u64;
    }
    sum
}

/// The detail whose count comes nearest to `wanted`.
fn fit_detail(objects: &[Object], group_seed: u64, wanted: f64) -> f64 {
    let mut high = 1.0;
    while high < MAX_DETAIL && (count(objects, group_seed, high) as f64) < wanted {
        high *= 2.0;
    }
    let (mut low, mut best, mut least_miss) = (0.0, high, f64::INFINITY);
    let mut attempt = |detail: f64| {
        let triangles = count(objects, group_seed, detail) as f64;

        let miss = (triangles - wanted).abs();
        if miss < least_miss {
            (best, least_miss) = (detail, miss);
        }
        (triangles < wanted, least_miss <= CLOSE_ENOUGH * wanted)
    };
    for _ in 0..DETAIL_STEPS {
        let middle = 0.5 * (low + high);
        let (too_few, close) = attempt(middle);
        if close {
            return middle;
        }
        if too_few {
            low = middle;
        } else {
            high = middle;
        }
    }
    // Near the answer the count rises in steps, and where a part appears it may fall: look around.
    let middle = low;
    for k in 1..=NEARBY {
        let aside = NEARBY_STEP * f64::from(k / 2);
        let (_, close) = attempt(middle * if k % 2 == 0 { 1.0 + aside } else { 1.0 - aside });
        if close {
            break;
        }
    }
    best
}

/// Beyond this no file of 4 GiB could hold any of the scenes.
const MAX_DETAIL: f64 = 32.0;
/// Halvings of the detail's interval: one in 16,000.
const DETAIL_STEPS: u32 = 14;
/// A count off by no more than this share will do.
const CLOSE_ENOUGH: f64 = 0.003;
/// Details tried around the one the bisection ends at, and their distance.
const NEARBY: u32 = 60;
const NEARBY_STEP: f64 = 0.002;

#[cfg(test)]
mod tests;
