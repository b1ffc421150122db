//! The original surface below a hlod: which leaf is nearest, and how near.

use crate::store::{Store, StoreError};
use crate::verify::position;
use geometry::bounds::Aabb;
use geometry::hausdorff::Surface;
use glam::DVec3;
use protocol::format::mesh::vertices_of;
use protocol::format::{Level, Skeleton};
use protocol::id::{BlobId, HlodId};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Samples that are finished together, so that each leaf they need is at hand once for all of them.
const TOGETHER: usize = 1024;

/// Triangles in scene units.
pub(super) struct Placed {
    pub(super) triangles: Vec<[DVec3; 3]>,
    /// Greatest sum of magnitudes in a coordinate: what its rounding goes with.
    pub(super) reach: f64,
}

/// All parts of a level.
pub(super) fn placed(store: &Store, level: &Level) -> Result<Placed, StoreError> {
    let skeleton = store.skeleton();
    let mut triangles = Vec::with_capacity(level.triangles as usize);
    let mut reach = 0.0f64;
    for part in skeleton.parts_of(level) {
        let id = BlobId(part.blob);
        let (blob, bytes) = (skeleton.blob(id), store.load_blob(id)?);
        let transform = skeleton.transform_of(part);
        let mut place = |vertex| {
            let p = position(blob, &vertex);
            for k in 0..3 {
                let terms = (0..3).map(|j| (transform.linear[j][k] * p[j]).abs());
                reach = reach.max(terms.sum::<f64>() + transform.translation[k].abs());
            }
            DVec3::from_array(transform.apply(p))
        };
        let points: Vec<DVec3> = vertices_of(blob, &bytes).map(&mut place).collect();
        let indices = &bytes[blob.vertex_bytes()..][..blob.triangles as usize * 6];
        let (pairs, _) = indices.as_chunks::<2>();
        let (corners, _) = pairs.as_chunks::<3>();
        let corner = |pair: [u8; 2]| points[usize::from(u16::from_le_bytes(pair))];
        triangles.extend(corners.iter().map(|pairs| pairs.map(corner)));
    }
    Ok(Placed { triangles, reach })
}

/// Calls for every leaf at or below a hlod, in the order of the tree.
pub(super) fn each_leaf_below(skeleton: &Skeleton, id: HlodId, mut call: impl FnMut(HlodId)) {
    let mut waiting = vec![id];
    while let Some(id) = waiting.pop() {
        let hlod = skeleton.hlod(id);
        if hlod.child_count == 0 {
            call(id);
        }
        waiting.extend(skeleton.children_of(hlod).rev());
    }
}

/// The original geometry of one leaf.
struct Leaf {
    surface: Surface,
    reach: f64,
}

/// Search trees of leaves, those kept that were used last.
pub(super) struct Leaves<'a> {
    store: &'a Store,
    kept: Mutex<Kept>,
}

/// Leaves by the time of their last use, within a limit.
#[derive(Default)]
struct Kept {
    limit: usize,
    bytes: usize,
    clock: u64,
    /// Last use of each kept leaf.
    used: BTreeMap<u32, u64>,
    leaves: BTreeMap<u64, (u32, Arc<Leaf>)>,
}

impl Kept {
    fn get(&mut self, id: HlodId) -> Option<Arc<Leaf>> {
        let (_, leaf) = self.leaves.remove(self.used.get(&id.0)?)?;
        self.put_last(id, leaf.clone());
        Some(leaf)
    }

    fn put_last(&mut self, id: HlodId, leaf: Arc<Leaf>) {
        self.clock += 1;
        self.used.insert(id.0, self.clock);
        self.leaves.insert(self.clock, (id.0, leaf));
    }

    /// Keeps a leaf, unless another thread was faster; forgets the oldest.
    fn put(&mut self, id: HlodId, leaf: Arc<Leaf>) {
        if self.used.contains_key(&id.0) {
            return;
        }
        self.bytes += leaf.surface.bytes();
        self.put_last(id, leaf);
        while self.bytes > self.limit
            && let Some((_, (id, leaf))) = self.leaves.pop_first()
        {
            self.used.remove(&id);
            self.bytes -= leaf.surface.bytes();
        }
    }
}

impl<'a> Leaves<'a> {
    pub(super) fn new(store: &'a Store, limit: usize) -> Self {
        Self { store, kept: Mutex::new(Kept { limit, ..Kept::default() }) }
    }

    /// Bytes of what is kept.
    #[cfg(test)]
    pub(super) fn bytes(&self) -> usize {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).bytes
    }

    fn leaf(&self, id: HlodId) -> Result<Arc<Leaf>, StoreError> {
        let kept = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(leaf) = kept().get(id) {
            return Ok(leaf);
        }
        let skeleton = self.store.skeleton();
        let Placed { triangles, reach } =
            placed(self.store, &skeleton.levels_of(skeleton.hlod(id))[0])?;
        let leaf = Arc::new(Leaf { surface: Surface::of_triangles(triangles.into_iter()), reach });
        kept().put(id, leaf.clone());
        Ok(leaf)
    }

    /// The greatest distance from a sample to the original below a hlod, and the reach of the leaves
    /// that were asked.
    ///
    /// Each sample first asks the leaf whose box is nearest. That bounds its distance; then the
    /// farthest go on to all leaves that could be nearer, until no other can be farthest.
    pub(super) fn farthest(&self, id: HlodId, samples: &[DVec3]) -> Result<(f64, f64), StoreError> {
        let skeleton = self.store.skeleton();
        let mut nearest = Nearest {
            leaves: self,
            samples,
            distances: vec![f64::INFINITY; samples.len()],
            greatest: 0.0,
            reach: 0.0,
        };
        let first: Vec<u32> = samples.iter().map(|p| likely_leaf(skeleton, id, *p).0).collect();
        nearest.ask(first.iter().copied().zip(0..).collect())?;

        let mut order: Vec<u32> = (0..samples.len() as u32).collect();
        let distances = &nearest.distances;
        order.sort_by(|&a, &b| distances[b as usize].total_cmp(&distances[a as usize]));
        for together in order.chunks(TOGETHER) {
            if nearest.distances[together[0] as usize] <= nearest.greatest {
                break;
            }
            let mut pairs = Vec::new();
            for &sample in together {
                let (p, bound) = (samples[sample as usize], nearest.distances[sample as usize]);
                each_leaf_within(skeleton, id, p, bound, |leaf| {
                    if leaf.0 != first[sample as usize] {
                        pairs.push((leaf.0, sample));
                    }
                });
            }
            nearest.ask(pairs)?;
            let greatest = together.iter().map(|&sample| nearest.distances[sample as usize]);
            nearest.greatest = greatest.fold(nearest.greatest, f64::max);
        }
        Ok((nearest.greatest, nearest.reach))
    }
}

/// What some samples know of their distance.
struct Nearest<'a> {
    leaves: &'a Leaves<'a>,
    samples: &'a [DVec3],
    distances: Vec<f64>,
    /// Distance of the farthest sample that is finished; no other needs less.
    greatest: f64,
    reach: f64,
}

impl Nearest<'_> {
    /// Holds pairs of leaf and sample against each other, leaf after leaf.
    fn ask(&mut self, mut pairs: Vec<(u32, u32)>) -> Result<(), StoreError> {
        pairs.sort_unstable();
        for run in pairs.chunk_by(|a, b| a.0 == b.0) {
            let id = HlodId(run[0].0);
            let leaf = self.leaves.leaf(id)?;
            let bounds = bounds(self.leaves.store.skeleton(), id);
            self.reach = self.reach.max(leaf.reach);
            let mut hint = 0;
            for &(_, sample) in run {
                let (p, so_far) = (self.samples[sample as usize], self.distances[sample as usize]);
                if so_far > self.greatest && bounds.distance(p) < so_far {
                    let distance = leaf.surface.exact_distance(p, self.greatest, &mut hint);
                    self.distances[sample as usize] = so_far.min(distance);
                }
            }
        }
        Ok(())
    }
}

fn bounds(skeleton: &Skeleton, id: HlodId) -> Aabb {
    let hlod = skeleton.hlod(id);
    Aabb { min: hlod.min.into(), max: hlod.max.into() }
}

/// The leaf found by going to the nearest box, child by child.
fn likely_leaf(skeleton: &Skeleton, mut id: HlodId, p: DVec3) -> HlodId {
    let distance = |child: &HlodId| {
        let bounds = bounds(skeleton, *child);
        (bounds.distance(p), bounds.center().distance_squared(p))
    };
    let nearer = |a: &(f64, f64), b: &(f64, f64)| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1));
    let next = |id| {
        let children =
            skeleton.children_of(skeleton.hlod(id)).map(|child| (distance(&child), child));
        children.min_by(|a, b| nearer(&a.0, &b.0))
    };
    while let Some((_, child)) = next(id) {
        id = child;
    }
    id
}

/// Calls for every leaf whose box is nearer than `bound`.
fn each_leaf_within(
    skeleton: &Skeleton,
    id: HlodId,
    p: DVec3,
    bound: f64,
    mut call: impl FnMut(HlodId),
) {
    let mut waiting = vec![id];
    while let Some(id) = waiting.pop() {
        if bounds(skeleton, id).distance(p) >= bound {
            continue;
        }
        let hlod = skeleton.hlod(id);
        if hlod.child_count == 0 {
            call(id);
        }
        waiting.extend(skeleton.children_of(hlod));
    }
}
