//! From objects to leaves and a tree over them (paper 004, section 2.2): large meshes divided,
//! small objects clustered by proximity, uneven clusters divided again, and a balanced hierarchy of
//! boxes built top down.

use crate::bulk::{self, Bulk};
use crate::bytes::{Decoder, Encoder, Torn};
use crate::giant::Giant;
use crate::grid;
use crate::options::Options;
use crate::pieces::{ALL_PIECES, PieceMesh};
use crate::slice::{Slicer, stretch};
use crate::spool::Scene;
use crate::work::{Appender, Records, Span, Work, WorkError};
use geometry::bounds::Aabb;
use geometry::cluster::{ClusterItem, ClusterLimits, SplitLimits, cluster, split_uneven};
use geometry::criteria::{self, Criteria};
use geometry::hierarchy::{self, Tree};
use geometry::mesh::largest_stretch;
use glam::{DAffine3, DVec3};
use protocol::format::{NONE, Transform};
use rayon::prelude::*;
use std::ops::Range;

/// A cluster whose members' boxes have less than this share of its own box's surface is uneven.
const LEAST_FILL: f64 = 0.5;
const PIECES: &str = "pieces";
/// Rounding by more than so many steps of the grid that suits the scene is noted. A piece as long as the scene
/// needs two.
const NOTED_STEPS: f64 = 8.0;
/// Most notes that name an object.
const MOST_NOTES: u64 = 8;
/// Bytes that a mesh being divided takes, by byte of its own.
const SLICING_FACTOR: u64 = 3;
/// Bytes of small meshes that are divided at once: more keep no thread busier.
const MOST_BATCH_BYTES: u64 = 32 << 20;
/// Gap within which a cluster of one triangle may grow, as a share of the longest side a leaf may
/// have; a cluster of more reaches less far in proportion (the k of Felzenszwalb and Huttenlocher).
const CLUSTER_REACH: f64 = 32.0;

/// What is known of a piece that lies on disk.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PieceInfo {
    /// Index into [`Scene::meshes`].
    pub(crate) mesh: u32,
    /// Several objects show it, so it lies in the mesh's own space.
    pub(crate) is_shared: bool,
    pub(crate) triangles: u32,
    pub(crate) vertices: u32,
    pub(crate) source_triangles: u64,
    pub(crate) step: f64,
    /// How far rounding has moved a vertex at most.
    pub(crate) error: f64,
    pub(crate) bounds: Aabb,
    span: Span,
    /// Its seams, where they are not with it.
    seams: Span,
}

/// All pieces of a scene, mesh after mesh.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Pieces {
    pub(crate) infos: Vec<PieceInfo>,
    /// Those of mesh `m`: `first[m]..first[m + 1]`.
    first: Vec<u32>,
    pub(crate) notes: Vec<String>,
}

impl Pieces {
    /// Divides every mesh and writes the pieces. Meshes are read as many at a time as fit the memory,
    /// and one that does not fit is never in it as a whole. `done` hears of each mesh.
    pub(crate) fn make(
        work: &Work,
        scene: &Scene,
        options: &Options,
        done: impl Fn() + Sync,
    ) -> Result<Self, WorkError> {
        let budget = options.memory / SLICING_FACTOR;
        let placements = placements(scene);
        let slicer = Slicer { options, scene_diagonal: diagonal(scene) };
        let bulk_of = |mesh| bulk::placed(scene.samples_of(mesh), &DAffine3::IDENTITY, 1.0);
        let source = Scene::open(work)?;
        let mut file = Appender::create(&work.path(PIECES))?;
        let mut pieces = Self { first: vec![0], ..Self::default() };
        let mut next = 0;
        while next < scene.meshes.len() {
            if scene.meshes[next].bytes() > budget && !placements[next].is_empty() {
                let giant = Giant {
                    work,
                    scene,
                    source: &source,
                    mesh: next,
                    frame: slicer.frame(&placements[next], Bulk::of(bulk_of(next))),
                    memory: options.memory,
                };
                pieces.add_giant(&mut file, &giant, placements[next].len())?;
                done();
                next += 1;
                continue;
            }
            let batch = batch(scene, next, budget.min(MOST_BATCH_BYTES));
            next = batch.end;
            let made: Vec<Vec<PieceMesh>> = batch
                .clone()
                .into_par_iter()
                .map(|mesh| {
                    let own = match placements[mesh].is_empty() {
                        true => Vec::new(),
                        false => slicer.pieces(
                            &scene.mesh(&source, mesh)?,
                            &placements[mesh],
                            Bulk::of(bulk_of(mesh)),
                        ),
                    };
                    done();
                    Ok(own)
                })
                .collect::<Result<_, WorkError>>()?;
            for (mesh, own) in batch.zip(made) {
                pieces.add(&mut file, scene, mesh, placements[mesh].len(), own)?;
            }
        }
        file.flush()?;
        pieces.note_rounded(scene, &placements, slicer.scene_diagonal);
        Ok(pieces)
    }

    /// Says which objects have vertices on a much coarser grid than a scene of this diagonal calls for.
    fn note_rounded(&mut self, scene: &Scene, placements: &[Vec<DAffine3>], diagonal: f64) {
        let mut objects: Vec<Option<&str>> = vec![None; scene.meshes.len()];
        for object in &scene.objects {
            objects[object.mesh].get_or_insert(&object.name);
        }
        let mut more = 0u64;
        for (mesh, name) in objects.into_iter().enumerate() {
            let own = &self.infos[self.of_mesh(mesh)];
            let scene = diagonal / stretch(&placements[mesh]);
            if own.is_empty() || !scene.is_finite() {
                continue;
            }
            let step = grid::common_step(f64::INFINITY, scene);
            let rounded = own.iter().filter(|info| info.error > NOTED_STEPS * step);
            let (vertices, farthest) =
                rounded.fold((0u64, 0.0f64), |(vertices, farthest), info| {
                    (vertices + u64::from(info.vertices), farthest.max(info.error))
                });
            let Some(name) = name.filter(|_| vertices > 0) else { continue };
            if (self.notes.len() as u64) < MOST_NOTES {
                self.notes.push(format!(
                    "object \"{name}\": {vertices} vertices of triangles that reach far beyond the rest of \
                     the scene, or are shared with such, are rounded by up to {farthest:e} units"
                ));
            } else {
                more += 1;
            }
        }
        if more > 0 {
            self.notes
                .push(format!("{more} more objects have vertices that are rounded like this"));
        }
    }

    fn add(
        &mut self,
        file: &mut Appender,
        scene: &Scene,
        mesh: usize,
        users: usize,
        made: Vec<PieceMesh>,
    ) -> Result<(), WorkError> {
        for piece in made {
            self.add_piece(file, mesh, users, &piece)?;
        }
        self.end_mesh(scene, mesh, users);
        Ok(())
    }

    fn add_giant(
        &mut self,
        file: &mut Appender,
        giant: &Giant<'_>,
        users: usize,
    ) -> Result<(), WorkError> {
        let first = self.infos.len();
        let add = |file: &mut Appender, piece| self.add_piece(file, giant.mesh, users, &piece);
        let seams = giant.pieces(file, add)?;
        self.infos[first..].iter_mut().zip(seams).for_each(|(info, seams)| info.seams = seams);
        self.end_mesh(giant.scene, giant.mesh, users);
        Ok(())
    }

    fn add_piece(
        &mut self,
        file: &mut Appender,
        mesh: usize,
        users: usize,
        piece: &PieceMesh,
    ) -> Result<(), WorkError> {
        let span = file.add(&[&piece.encode()])?;
        // Decoded vertices of what is placed later lie up to a rounding outside.
        let bounds = piece.bounds().grown(piece.step);
        self.infos.push(PieceInfo {
            mesh: mesh as u32,
            is_shared: users > 1,
            triangles: piece.triangles.len() as u32,
            vertices: piece.vertices.len() as u32,
            source_triangles: piece.source_triangles,
            step: piece.step,
            error: piece.error,
            bounds,
            span,
            seams: Span::default(),
        });
        Ok(())
    }

    fn end_mesh(&mut self, scene: &Scene, mesh: usize, users: usize) {
        if self.infos.len() == self.first[mesh] as usize && users > 0 {
            let name = &scene.meshes[mesh].name;
            self.notes
                .push(format!("mesh \"{name}\" is left out: it has no triangle with an area"));
        }
        self.first.push(self.infos.len() as u32);
    }

    /// Pieces of a mesh.
    pub(crate) fn of_mesh(&self, mesh: usize) -> Range<usize> {
        self.first[mesh] as usize..self.first[mesh + 1] as usize
    }

    /// The file they lie in.
    pub(crate) fn open(work: &Work) -> Result<Records, WorkError> {
        Records::open(&work.path(PIECES))
    }

    /// Reads one back.
    pub(crate) fn read(&self, from: &Records, index: usize) -> Result<PieceMesh, WorkError> {
        let info = &self.infos[index];
        let mut piece = PieceMesh::decode(&from.read(info.span)?).map_err(|_| from.torn())?;
        if info.seams.bytes > 0 {
            let pairs = from.read(info.seams)?;
            piece.seams = pairs.chunks_exact(8).map(bytemuck::pod_read_unaligned).collect();
        }
        Ok(piece)
    }

    /// Whether the file holds all of them as they were written.
    pub(crate) fn is_whole(&self, work: &Work) -> bool {
        let seams = self.infos.iter().map(|piece| piece.seams).filter(|seams| seams.bytes > 0);
        let spans = self.infos.iter().map(|piece| piece.span).chain(seams);
        Self::open(work).is_ok_and(|file| file.holds(spans))
    }

    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut out = Encoder::default();
        out.put(self.infos.len() as u64);
        for piece in &self.infos {
            out.put([piece.mesh, u32::from(piece.is_shared), piece.triangles, piece.vertices]);
            out.put(piece.source_triangles);
            out.put([piece.step, piece.error]);
            out.put([piece.bounds.min.to_array(), piece.bounds.max.to_array()]);
            out.put([piece.span, piece.seams]);
        }
        out.put_slice(&self.first);
        out.put(self.notes.len() as u64);
        self.notes.iter().for_each(|note| out.put_text(note));
        out.0
    }

    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, Torn> {
        let from = &mut Decoder(bytes);
        let mut pieces = Self::default();
        for _ in 0..from.take_count()? {
            let [mesh, shared, triangles, vertices] = from.take::<[u32; 4]>()?;
            let source_triangles = from.take()?;
            let [step, error] = from.take()?;
            let [min, max]: [[f64; 3]; 2] = from.take()?;
            let bounds = Aabb { min: min.into(), max: max.into() };
            let [span, seams] = from.take::<[Span; 2]>()?;
            pieces.infos.push(PieceInfo {
                mesh,
                is_shared: shared == 1,
                triangles,
                vertices,
                source_triangles,
                step,
                error,
                bounds,
                span,
                seams,
            });
        }
        pieces.first = from.take_slice()?;
        for _ in 0..from.take_count()? {
            pieces.notes.push(from.take_text()?);
        }
        if from.0.is_empty() { Ok(pieces) } else { Err(Torn) }
    }
}

/// Where the objects of each mesh stand.
fn placements(scene: &Scene) -> Vec<Vec<DAffine3>> {
    let mut placements = vec![Vec::new(); scene.meshes.len()];
    for object in &scene.objects {
        placements[object.mesh].push(object.world_from_mesh);
    }
    placements
}

/// As many meshes from `first` on as `budget` bytes hold, at least one.
fn batch(scene: &Scene, first: usize, budget: u64) -> Range<usize> {
    let mut bytes = scene.meshes[first].bytes();
    let mut end = first + 1;
    while end < scene.meshes.len() && bytes + scene.meshes[end].bytes() <= budget {
        bytes += scene.meshes[end].bytes();
        end += 1;
    }
    first..end
}

/// Diagonal of a box around all objects, but no more than most of them reach: strays do not count.
fn diagonal(scene: &Scene) -> f64 {
    let objects = || scene.objects.iter().filter(|o| !scene.meshes[o.mesh].bounds.is_empty());
    let boxes = objects().map(|o| placed_box(scene.meshes[o.mesh].bounds, &o.world_from_mesh));
    let whole = boxes.fold(Aabb::EMPTY, Aabb::union).diagonal();
    let samples = objects().flat_map(|o| {
        let stretch = largest_stretch(&o.world_from_mesh.matrix3);
        bulk::placed(scene.samples_of(o.mesh), &o.world_from_mesh, stretch)
    });
    whole.min(Bulk::of(samples).reach)
}

/// The box around a placed box.
fn placed_box(inner: Aabb, target_from_box: &DAffine3) -> Aabb {
    Aabb::of((0..8).map(|corner| {
        let pick = |k: usize| if corner >> k & 1 == 1 { inner.max[k] } else { inner.min[k] };
        target_from_box.transform_point3(DVec3::new(pick(0), pick(1), pick(2)))
    }))
}

/// A piece of one object, somewhere in a leaf.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Member {
    /// Source object.
    pub(crate) object: u32,
    /// Index into [`Pieces::infos`].
    pub(crate) piece: u32,
    /// Index into [`Plan::transforms`], or [`NONE`] for a piece that lies in the world.
    pub(crate) transform: u32,
    /// World box, near enough to build a tree over.
    bounds: Aabb,
}

/// How many things there were after each step: the columns of paper 004, table 1.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    /// Objects of the source that have triangles.
    pub(crate) objects: u64,
    /// After large ones were divided.
    pub(crate) divided: u64,
    /// After small ones were clustered.
    pub(crate) clusters: u64,
    /// After uneven clusters were divided again: the leaves.
    pub(crate) leaves: u64,
}

/// All leaves of a scene and the tree over them.
#[derive(Debug, Default)]
pub(crate) struct Plan {
    /// Leaf after leaf.
    pub(crate) members: Vec<Member>,
    /// Members of each leaf.
    pub(crate) leaves: Vec<Range<usize>>,
    /// Placements of objects whose meshes are shared.
    pub(crate) transforms: Vec<Transform>,
    pub(crate) tree: Tree,
    /// Of each node, the root at 0.
    pub(crate) depths: Vec<u8>,
    pub(crate) counts: Counts,
    /// How good the tree is.
    pub(crate) criteria: Criteria,
    /// How good a plain one over the source's own objects would be.
    pub(crate) plain_criteria: Criteria,
    /// Node of each object's pieces: `node_of[first_of[object] + n]` for the n-th of its mesh.
    node_of: Vec<u32>,
    first_of: Vec<u32>,
}

impl Plan {
    pub(crate) fn new(scene: &Scene, pieces: &Pieces, options: &Options) -> Self {
        let mut plan = Self::default();
        let mut candidates = Vec::new();
        let mut object_boxes = Vec::new();
        let mut object_triangles = Vec::new();
        for (index, object) in scene.objects.iter().enumerate() {
            plan.first_of.push(candidates.len() as u32);
            let own = pieces.of_mesh(object.mesh);
            let Some(first) = pieces.infos.get(own.start).filter(|_| !own.is_empty()) else {
                continue;
            };
            let transform = if first.is_shared {
                plan.transforms.push(transform(&object.world_from_mesh));
                plan.transforms.len() as u32 - 1
            } else {
                NONE
            };
            let mut whole = (Aabb::EMPTY, 0u32);
            candidates.extend(own.map(|piece| {
                let info = &pieces.infos[piece];
                let bounds = match transform {
                    NONE => info.bounds,
                    _ => placed_box(info.bounds, &object.world_from_mesh),
                };
                whole = (whole.0.union(bounds), whole.1.saturating_add(info.triangles));
                Member { object: index as u32, piece: piece as u32, transform, bounds }
            }));
            object_boxes.push(whole.0);
            object_triangles.push(whole.1);
        }
        plan.counts.objects = object_boxes.len() as u64;
        plan.counts.divided = candidates.len() as u64;
        plan.group(&candidates, pieces, options, diagonal(scene));
        plan.link(&candidates, pieces, options);
        let plain = hierarchy::plain(&object_boxes, options.branching);
        plan.plain_criteria = criteria::measure(&plain, &object_boxes, &object_triangles);
        plan
    }

    /// Clusters candidates to leaves; `diagonal` is the scene's, strays left out.
    fn group(&mut self, candidates: &[Member], pieces: &Pieces, options: &Options, diagonal: f64) {
        let items: Vec<ClusterItem> = candidates
            .iter()
            .map(|member| ClusterItem {
                bounds: member.bounds,
                triangles: pieces.infos[member.piece as usize].triangles,
            })
            .collect();
        let extent = diagonal * options.piece_extent;
        let limits = ClusterLimits {
            triangles: options.piece_triangles as u32,
            extent,
            scale: extent * CLUSTER_REACH,
        };
        let split =
            SplitLimits { fill: LEAST_FILL, least_triangles: options.piece_least_triangles as u32 };
        // Shared pieces stay shared, so they have clusters of their own.
        let (shared, own): (Vec<u32>, Vec<u32>) =
            (0..candidates.len() as u32).partition(|&id| candidates[id as usize].transform != NONE);
        for ids in [own, shared] {
            let items: Vec<ClusterItem> = ids.iter().map(|&id| items[id as usize]).collect();
            let clusters = cluster(&items, &limits);
            self.counts.clusters += clusters.len() as u64;
            for members in clusters.iter().flat_map(|cluster| split_uneven(&items, cluster, &split))
            {
                let first = self.members.len();
                let members = members.iter().map(|&item| candidates[ids[item as usize] as usize]);
                self.members.extend(members);
                self.leaves.push(first..self.members.len());
            }
        }
        self.counts.leaves = self.leaves.len() as u64;
    }

    /// Builds the tree and notes where every piece lies in it.
    fn link(&mut self, candidates: &[Member], pieces: &Pieces, options: &Options) {
        let boxes: Vec<Aabb> = self
            .leaves
            .iter()
            .map(|leaf| self.members[leaf.clone()].iter().map(|m| m.bounds))
            .map(|bounds| bounds.fold(Aabb::EMPTY, Aabb::union))
            .collect();
        let triangles: Vec<u32> = self
            .leaves
            .iter()
            .map(|leaf| &self.members[leaf.clone()])
            .map(|m| m.iter().map(|m| pieces.infos[m.piece as usize].triangles).sum())
            .collect();
        self.tree = hierarchy::build(&boxes, &triangles, options.branching);
        self.criteria = criteria::measure(&self.tree, &boxes, &triangles);
        self.depths = self.tree.depths().into_iter().map(|depth| depth as u8).collect();
        self.node_of = vec![0; candidates.len()];
        for (node, leaf) in self.tree.nodes.iter().enumerate() {
            let Some(item) = leaf.item else { continue };
            for member in &self.members[self.leaves[item as usize].clone()] {
                let number = self.number_of(member, pieces);
                self.node_of[number] = node as u32;
            }
        }
    }

    /// Place of a member among all candidates.
    fn number_of(&self, member: &Member, pieces: &Pieces) -> usize {
        let mesh = pieces.infos[member.piece as usize].mesh as usize;
        let within = member.piece as usize - pieces.of_mesh(mesh).start;
        self.first_of[member.object as usize] as usize + within
    }

    /// Depth of the node in which a member and the piece `other` of its mesh, counted within the
    /// mesh, come together.
    pub(crate) fn meeting_depth(&self, member: &Member, other: u32, pieces: &Pieces) -> u8 {
        if other == ALL_PIECES {
            return 0;
        }
        let mut a = self.node_of[self.number_of(member, pieces)];
        let mut b = self.node_of[(self.first_of[member.object as usize] + other) as usize];
        while a != b {
            // A parent's number is less than its children's.
            let deeper = if a > b { &mut a } else { &mut b };
            *deeper = self.tree.nodes[*deeper as usize].parent.unwrap_or(0);
        }
        self.depths[a as usize]
    }

    /// Source triangles below each node.
    pub(crate) fn source_triangles(&self, pieces: &Pieces) -> Vec<u64> {
        let mut triangles = vec![0; self.tree.nodes.len()];
        for (id, node) in self.tree.nodes.iter().enumerate().rev() {
            if let Some(item) = node.item {
                let members = &self.members[self.leaves[item as usize].clone()];
                let own = members.iter().map(|m| pieces.infos[m.piece as usize].source_triangles);
                triangles[id] = own.sum();
            }
            if let Some(parent) = node.parent {
                triangles[parent as usize] += triangles[id];
            }
        }
        triangles
    }
}

fn transform(world_from_mesh: &DAffine3) -> Transform {
    Transform {
        linear: world_from_mesh.matrix3.to_cols_array_2d(),
        translation: world_from_mesh.translation.to_array(),
    }
}
