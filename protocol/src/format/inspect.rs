//! What is in a scene file, in numbers.

mod comparison;

pub use comparison::{Comparison, Pair};

use super::{Blob, Class, Hlod, Method, NONE, Skeleton};
use serde::Serialize;

/// Counts and qualities of a skeleton.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// Hlods, leaves included.
    pub hlods: u64,
    /// Hlods without children.
    pub leaves: u64,
    /// Levels of all hlods.
    pub levels: u64,
    /// Placed meshes of all levels.
    pub parts: u64,
    /// Meshes and faces of scan cubes.
    pub blobs: u64,
    /// Parts of the finest levels of leaves that are placed by a transform.
    pub instances: u64,
    /// Placements.
    pub transforms: u64,
    /// Textures.
    pub textures: u64,
    /// Triangles of all meshes by what they do to what lies behind them.
    pub classes: Classes,
    /// Share of the triangles of all meshes whose vertices are textured; 0 where there are none.
    pub textured_share: f64,
    /// Objects of the source.
    pub objects: u64,
    /// Hlods on the longest path from the root to a leaf, both counted.
    pub depth: u32,
    /// Triangles of the source, instances counted each.
    pub source_triangles: u64,
    /// Triangles of the source, shared meshes counted once.
    pub unique_triangles: u64,
    /// The scene's box: least and greatest corner, scene units.
    pub bounds: [[f64; 3]; 2],
    /// One row for each depth, the root's first.
    pub tree: Vec<TreeLevel>,
    /// Where the bytes are.
    pub bytes: BytesByKind,
    /// Least error of a level, scene units.
    pub error_min: f64,
    /// Greatest error of a level, scene units.
    pub error_max: f64,
    /// Children of an inner hlod.
    pub branching: Branching,
    /// Surface area of all pairwise overlaps of siblings over their parent's area, mean over inner
    /// hlods whose box has an area: 0 where siblings are disjoint or touch.
    pub overlap_mean: f64,
    /// The greatest such ratio.
    pub overlap_max: f64,
    /// View cells and scan cubes.
    pub far_fields: FarFields,
    /// How good the tree is, measured by the bake.
    pub criteria: Option<Comparison>,
}

/// Triangles by class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Classes {
    /// Opaque.
    pub opaque: u64,
    /// With holes.
    pub mask: u64,
    /// Mixing with what lies behind them.
    pub blend: u64,
    /// Of all of these, those seen from both sides.
    pub double_sided: u64,
}

/// View cells by what stands for what lies outside them, and their scan cubes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct FarFields {
    /// Cells whose far field is cheaper as geometry.
    pub none: u64,
    /// Cells with textured depth meshes.
    pub tdm: u64,
    /// Cells with incremental ones.
    pub itdm: u64,
    /// Scan cubes of all cells.
    pub cubes: u64,
    /// Of those, cubes that depend on another.
    pub delta_cubes: u64,
    /// Triangles of all their faces.
    pub triangles: u64,
}

/// The hlods at one depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct TreeLevel {
    /// Hlods.
    pub hlods: u64,
    /// Of those, leaves.
    pub leaves: u64,
    /// Triangles of their finest levels.
    pub finest_triangles: u64,
    /// Triangles of their coarsest levels.
    pub coarsest_triangles: u64,
}

/// Bytes of the scene file by what they hold; headers and padding between sections not counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct BytesByKind {
    /// Hlod records.
    pub hlods: u64,
    /// Level records.
    pub levels: u64,
    /// Part records.
    pub parts: u64,
    /// Blob records.
    pub blobs: u64,
    /// Transform records.
    pub transforms: u64,
    /// Texture records and lists.
    pub textures: u64,
    /// View cell records.
    pub view_cells: u64,
    /// Scan cube records.
    pub cubes: u64,
    /// Vertices of all meshes.
    pub vertices: u64,
    /// Indices of all meshes.
    pub indices: u64,
    /// Faces of scan cubes: vertices, indices and pictures.
    pub faces: u64,
    /// Textures with their mips.
    pub pixels: u64,
}

/// Numbers of children of the inner hlods; all 0 when there are none.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Branching {
    /// Fewest.
    pub min: u32,
    /// Most.
    pub max: u32,
    /// Mean.
    pub mean: f64,
}

/// Counts what is in a skeleton that has passed [`super::check()`].
pub fn summary(skeleton: &Skeleton) -> Inspection {
    let hlods = &skeleton.hlods;
    let tree = tree_levels(skeleton);
    let finest_of_leaves =
        hlods.iter().filter(|h| h.child_count == 0).filter_map(|h| skeleton.levels_of(h).first());
    let placed =
        finest_of_leaves.flat_map(|l| skeleton.parts_of(l)).filter(|p| p.transform != NONE);
    let triangles = |all: bool| -> u64 {
        let blobs = meshes(skeleton).filter(|b| all || b.is_textured());
        blobs.map(|b| u64::from(b.triangles)).sum()
    };
    let errors = skeleton.levels.iter().map(|l| l.error);
    let overlaps: Vec<f64> = hlods.iter().filter_map(|h| overlap(skeleton, h)).collect();
    Inspection {
        hlods: hlods.len() as u64,
        leaves: tree.iter().map(|t| t.leaves).sum(),
        levels: skeleton.levels.len() as u64,
        parts: skeleton.parts.len() as u64,
        blobs: skeleton.blobs.len() as u64,
        instances: placed.count() as u64,
        transforms: skeleton.transforms.len() as u64,
        textures: skeleton.textures.len() as u64,
        classes: classes(skeleton),
        textured_share: triangles(false) as f64 / triangles(true).max(1) as f64,
        objects: u64::from(skeleton.info.objects),
        depth: tree.len() as u32,
        source_triangles: skeleton.info.source_triangles,
        unique_triangles: skeleton.info.unique_triangles,
        bounds: [hlods[0].min, hlods[0].max],
        tree,
        bytes: bytes_by_kind(skeleton),
        error_min: errors.clone().reduce(f64::min).unwrap_or(0.0),
        error_max: errors.fold(0.0, f64::max),
        branching: branching(hlods),
        overlap_mean: overlaps.iter().sum::<f64>() / overlaps.len().max(1) as f64,
        overlap_max: overlaps.iter().copied().fold(0.0, f64::max),
        far_fields: far_fields(skeleton),
        criteria: Comparison::of(&skeleton.info),
    }
}

/// Blobs that are no faces.
fn meshes(skeleton: &Skeleton) -> impl Iterator<Item = &Blob> {
    skeleton.blobs.iter().filter(|blob| !blob.is_projected())
}

fn far_fields(skeleton: &Skeleton) -> FarFields {
    let cells = |method| {
        let of_method = skeleton.view_cells.iter().filter(|c| Method::of(c.method) == Some(method));
        of_method.count() as u64
    };
    FarFields {
        none: cells(Method::None),
        tdm: cells(Method::Tdm),
        itdm: cells(Method::Itdm),
        cubes: skeleton.cubes.len() as u64,
        delta_cubes: skeleton.cubes.iter().filter(|c| c.parent != NONE).count() as u64,
        triangles: skeleton.cubes.iter().map(|c| u64::from(c.triangles)).sum(),
    }
}

fn tree_levels(skeleton: &Skeleton) -> Vec<TreeLevel> {
    let mut rows: Vec<TreeLevel> = Vec::new();
    let mut depth = vec![0usize; skeleton.hlods.len()];
    for (i, hlod) in skeleton.hlods.iter().enumerate() {
        if hlod.parent != NONE {
            depth[i] = depth[hlod.parent as usize] + 1;
        }
        if depth[i] == rows.len() {
            rows.push(TreeLevel::default());
        }
        let row = &mut rows[depth[i]];
        let levels = skeleton.levels_of(hlod);
        row.hlods += 1;
        row.leaves += u64::from(hlod.child_count == 0);
        row.finest_triangles += levels.first().map_or(0, |l| u64::from(l.triangles));
        row.coarsest_triangles += levels.last().map_or(0, |l| u64::from(l.triangles));
    }
    rows
}

fn classes(skeleton: &Skeleton) -> Classes {
    let count = |of: fn(Class) -> bool| -> u64 {
        let all = meshes(skeleton).flat_map(|b| Class::ALL.into_iter().zip(b.classes));
        all.filter(|(class, _)| of(*class)).map(|(_, n)| u64::from(n)).sum()
    };
    Classes {
        opaque: count(Class::is_opaque),
        mask: count(Class::is_mask),
        blend: count(Class::is_blend),
        double_sided: count(|class| !class.is_single_sided()),
    }
}

fn bytes_by_kind(skeleton: &Skeleton) -> BytesByKind {
    let vertices = meshes(skeleton).map(|b| b.vertex_bytes() as u64).sum();
    let of_meshes: u64 = meshes(skeleton).map(|b| b.bytes).sum();
    let of_blobs: u64 = skeleton.blobs.iter().map(|b| b.bytes).sum();
    BytesByKind {
        hlods: size_of_val(&skeleton.hlods[..]) as u64,
        levels: size_of_val(&skeleton.levels[..]) as u64,
        parts: size_of_val(&skeleton.parts[..]) as u64,
        blobs: size_of_val(&skeleton.blobs[..]) as u64,
        transforms: size_of_val(&skeleton.transforms[..]) as u64,
        textures: (size_of_val(&skeleton.textures[..]) + size_of_val(&skeleton.texture_lists[..]))
            as u64,
        view_cells: size_of_val(&skeleton.view_cells[..]) as u64,
        cubes: size_of_val(&skeleton.cubes[..]) as u64,
        vertices,
        indices: of_meshes - vertices,
        faces: of_blobs - of_meshes,
        pixels: skeleton.textures.iter().map(|t| t.bytes).sum(),
    }
}

fn branching(hlods: &[Hlod]) -> Branching {
    let counts = hlods.iter().map(|h| h.child_count).filter(|&c| c > 0);
    let inner = counts.clone().count();
    if inner == 0 {
        return Branching::default();
    }
    Branching {
        min: counts.clone().min().unwrap_or(0),
        max: counts.clone().max().unwrap_or(0),
        mean: counts.map(f64::from).sum::<f64>() / inner as f64,
    }
}

/// Surface area of a box.
fn area(min: [f64; 3], max: [f64; 3]) -> f64 {
    let e: [f64; 3] = std::array::from_fn(|k| max[k] - min[k]);
    2.0 * (e[0] * e[1] + e[1] * e[2] + e[2] * e[0])
}

/// Area of what two boxes share; 0 where they only touch.
fn shared_area(a: &Hlod, b: &Hlod) -> f64 {
    let min: [f64; 3] = std::array::from_fn(|k| a.min[k].max(b.min[k]));
    let max: [f64; 3] = std::array::from_fn(|k| a.max[k].min(b.max[k]));
    // A flat box has no inside of its own along its normal, and yet overlaps what it cuts through.
    let flat = |h: &Hlod, k: usize| h.min[k] == h.max[k];
    let apart = |k| min[k] > max[k] || min[k] == max[k] && !flat(a, k) && !flat(b, k);
    if (0..3).any(apart) { 0.0 } else { area(min, max) }
}

/// Pairwise overlap of the children over the parent's area; `None` for leaves and boxes without area.
fn overlap(skeleton: &Skeleton, parent: &Hlod) -> Option<f64> {
    let whole = area(parent.min, parent.max);
    if parent.child_count == 0 || whole <= 0.0 {
        return None;
    }
    // Sorted along x, a child is held against those alone that begin before it ends.
    let mut children: Vec<&Hlod> = skeleton.children_of(parent).map(|c| skeleton.hlod(c)).collect();
    children.sort_by(|a, b| a.min[0].total_cmp(&b.min[0]));
    let mut shared = 0.0;
    for (i, a) in children.iter().enumerate() {
        let near = children[i + 1..].iter().take_while(|b| b.min[0] <= a.max[0]);
        shared += near.map(|b| shared_area(a, b)).sum::<f64>();
    }
    Some(shared / whole)
}

impl std::fmt::Display for Inspection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [min, max] = self.bounds;
        let b = &self.bytes;
        writeln!(f, "box           {min:?} to {max:?}")?;
        writeln!(f, "objects       {}, instances {}", self.objects, self.instances)?;
        writeln!(
            f,
            "triangles     {} in the source, {} without repeats",
            self.source_triangles, self.unique_triangles
        )?;
        writeln!(f, "hlods         {}, leaves {}, depth {}", self.hlods, self.leaves, self.depth)?;
        writeln!(
            f,
            "levels        {}, parts {}, blobs {}, transforms {}, textures {}",
            self.levels, self.parts, self.blobs, self.transforms, self.textures
        )?;
        let c = &self.classes;
        writeln!(
            f,
            "surfaces      opaque {}, mask {}, blend {} triangles, {} of them double-sided; {:.1}% textured",
            c.opaque,
            c.mask,
            c.blend,
            c.double_sided,
            100.0 * self.textured_share
        )?;
        let far = &self.far_fields;
        writeln!(
            f,
            "view cells    itdm {}, tdm {}, geometry alone {}; {} scan cubes, {} of them deltas, {} triangles",
            far.itdm, far.tdm, far.none, far.cubes, far.delta_cubes, far.triangles
        )?;
        writeln!(f, "errors        {} to {} scene units", self.error_min, self.error_max)?;
        writeln!(
            f,
            "children      {:.2} mean, {} to {}",
            self.branching.mean, self.branching.min, self.branching.max
        )?;
        writeln!(
            f,
            "overlap       {:.3} mean, {:.3} greatest (shared area / parent's area)",
            self.overlap_mean, self.overlap_max
        )?;
        writeln!(
            f,
            "bytes         hlods {}, levels {}, parts {}, blobs {}, transforms {}, textures {}, \
             view cells {}, cubes {}, vertices {}, indices {}, faces {}, pixels {}",
            b.hlods,
            b.levels,
            b.parts,
            b.blobs,
            b.transforms,
            b.textures,
            b.view_cells,
            b.cubes,
            b.vertices,
            b.indices,
            b.faces,
            b.pixels
        )?;
        if let Some(criteria) = &self.criteria {
            write!(f, "{criteria}")?;
        }
        writeln!(f, "depth      hlods     leaves    triangles, finest     coarsest")?;
        for (depth, t) in self.tree.iter().enumerate() {
            writeln!(
                f,
                "{depth:5} {:10} {:10} {:20} {:12}",
                t.hlods, t.leaves, t.finest_triangles, t.coarsest_triangles
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::fixture;

    #[test]
    fn counts_of_the_fixture() {
        let s = summary(&fixture::skeleton());
        assert_eq!((s.hlods, s.leaves, s.levels, s.blobs), (3, 2, 4, 7));
        assert_eq!((s.instances, s.transforms, s.objects, s.depth), (1, 1, 2, 2));
        assert_eq!((s.parts, s.textures), (5, 1));
        assert_eq!(s.classes, Classes { opaque: 3, mask: 1, blend: 1, double_sided: 4 });
        assert_eq!(s.textured_share, 0.2);
        assert_eq!((s.error_min, s.error_max), (0.0, 0.5));
        assert_eq!(s.branching, Branching { min: 2, max: 2, mean: 2.0 });
        let rows = [
            TreeLevel { hlods: 1, leaves: 0, finest_triangles: 1, coarsest_triangles: 1 },
            TreeLevel { hlods: 2, leaves: 2, finest_triangles: 4, coarsest_triangles: 3 },
        ];
        assert_eq!(s.tree, rows);
        assert_eq!((s.bytes.vertices, s.bytes.indices), (160 + 3 * 32, 8 + 12 + 8 + 8));
        assert_eq!((s.bytes.parts, s.bytes.textures, s.bytes.pixels), (5 * 8, 32 + 4, 4 * (4 + 1)));
        assert_eq!((s.overlap_mean, s.overlap_max), (0.0, 0.0));
    }

    #[test]
    fn faces_are_no_meshes() {
        let skeleton = fixture::skeleton();
        let s = summary(&skeleton);
        let far =
            FarFields { none: 1, tdm: 0, itdm: 1, cubes: 2, delta_cubes: 1, triangles: 1 + 2 + 1 };
        assert_eq!(s.far_fields, far);
        assert_eq!((s.bytes.view_cells, s.bytes.cubes), (2 * 72, 2 * 64));
        let large = 4 * 8 + 8 + 4 * 4 + 2 * 128;
        assert_eq!(s.bytes.faces, large + (24 + 12 + 4 + 2 * 128) + (24 + 8 + 4 + 128));
        let text = s.to_string();
        let line =
            "view cells    itdm 1, tdm 0, geometry alone 1; 2 scan cubes, 1 of them deltas, 4";
        assert!(text.contains(line), "{text}");
    }

    #[test]
    fn a_lone_leaf_has_no_branching_and_no_overlap() {
        let mut skeleton = fixture::skeleton();
        skeleton.hlods.truncate(1);
        (skeleton.hlods[0].child_count, skeleton.hlods[0].first_child) = (0, 0);
        let s = summary(&skeleton);
        assert_eq!((s.leaves, s.depth, s.branching), (1, 1, Branching::default()));
        assert_eq!(s.overlap_mean, 0.0);
    }

    #[test]
    fn overlap_counts_shared_space_and_not_touching_faces() {
        let mut skeleton = fixture::skeleton();
        // The root's area is 22; siblings [0, 2] and [1, 5] share a unit cube of area 6.
        skeleton.hlods[1].max[0] = 2.0;
        skeleton.hlods[2].min[0] = 1.0;
        assert_eq!(summary(&skeleton).overlap_max, 6.0 / 22.0);
        skeleton.hlods[2].min[0] = 2.0;
        assert_eq!(summary(&skeleton).overlap_max, 0.0);
        // A flat wall on the border is shared as a whole: both sides of a unit square.
        skeleton.hlods[2].max[0] = 2.0;
        assert_eq!(summary(&skeleton).overlap_max, 2.0 / 22.0);
    }

    #[test]
    fn the_text_names_every_depth() {
        let text = summary(&fixture::skeleton()).to_string();
        assert!(text.contains("hlods         3, leaves 2, depth 2"), "{text}");
        assert_eq!(text.lines().count(), 11 + 1 + 2);
    }
}
