//! Division of a mesh that does not fit the memory: the very pieces that `slice` makes, by reading the
//! mesh and files of the working folder front to back.

use crate::grid::Shared;
use crate::pieces::PieceMesh;
use crate::scratch::{Scratch, ScratchWriter};
use crate::seams::SeamFinder;
use crate::slice::{Frame, Gatherer, Local};
use crate::spool::Scene;
use crate::work::{Appender, Records, Span, Work, WorkError};
use geometry::bounds::Aabb;
use geometry::mesh::Mesh;
use geometry::partition::{Bins, Item, Piece, Splitter, Step, Tally};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// Bytes that a triangle takes while boxes are divided in memory.
const DIVIDED_BYTES: u64 = 64;
/// Bytes that a triangle takes at most while pieces are gathered, and made.
const GATHERED_BYTES: u64 = 320;
/// Bytes that a vertex takes while seams are found.
const SEAM_BYTES: u64 = 32;
/// The share of the memory that either takes: parts of the mesh and the pieces' list are in it, too.
const SHARE: u64 = 2;
/// The files that hold the seams count in, each by its buffer.
const LEAST_PLACES: u64 = 1 << 16;

/// A mesh on disk.
pub(crate) struct Giant<'a> {
    pub(crate) work: &'a Work,
    pub(crate) scene: &'a Scene,
    pub(crate) source: &'a Records,
    /// Its number.
    pub(crate) mesh: usize,
    pub(crate) frame: Frame<'a>,
    /// Bytes to work in.
    pub(crate) memory: u64,
}

/// How a mesh is divided: the triangles of all pieces, one after the other, and how many each has.
struct Parts {
    triangles: Scratch<u32>,
    counts: Vec<u32>,
    /// Of each piece.
    bounds: Vec<[Vec3; 2]>,
}

impl Giant<'_> {
    /// Makes the pieces and hands them out in order, without their seams; then appends these to
    /// `file`, and returns where those of each piece lie.
    pub(crate) fn pieces(
        &self,
        file: &mut Appender,
        mut out: impl FnMut(&mut Appender, PieceMesh) -> Result<(), WorkError>,
    ) -> Result<Vec<Span>, WorkError> {
        let bounds = self.bounds()?;
        let parts = self.parts()?;
        let steps: Vec<f64> =
            parts.bounds.iter().map(|&piece| self.frame.step(&bounds, piece)).collect();
        let vertices = self.scene.meshes[self.mesh].positions;
        let places = (self.memory / SHARE / SEAM_BYTES).max(LEAST_PLACES);
        let mut seams = SeamFinder::new(self.work, vertices, places)?;
        let most = (self.memory / SHARE / GATHERED_BYTES) as usize;
        let mut shared = Shared::new(&steps);
        // Those on a coarser grid than others say where what they share with them lies.
        if steps.iter().any(|&step| shared.is_coarse(step)) {
            let is_coarse: Vec<bool> = steps.iter().map(|&step| shared.is_coarse(step)).collect();
            self.gathered(
                &parts,
                most,
                |piece| is_coarse[piece],
                |first, meshes| {
                    for (mesh, &step) in meshes.iter().zip(&steps[first..]) {
                        if shared.is_coarse(step) {
                            shared.note(mesh, step);
                        }
                    }
                    Ok(())
                },
            )?;
        }
        self.gathered(
            &parts,
            most,
            |_| true,
            |first, meshes| {
                let pieces = meshes.into_par_iter().zip(&steps[first..]);
                let pieces = pieces.map(|(mesh, &step)| self.frame.piece(mesh, step, &shared));
                pieces.flatten_iter().collect::<Vec<_>>().into_iter().try_for_each(|piece| {
                    seams.add(&piece)?;
                    out(file, piece)
                })
            },
        )?;
        drop(parts);
        seams.finish(file)
    }

    fn bounds(&self) -> Result<Aabb, WorkError> {
        self.scene.parts_of(self.mesh).try_fold(Aabb::EMPTY, |bounds, part| {
            let part = self.scene.some_parts(self.source, part..part + 1)?;
            Ok(bounds.union(self.frame.bounds(&part)))
        })
    }

    /// Divides the mesh: sets that do not fit the memory are cut into two files each.
    fn parts(&self) -> Result<Parts, WorkError> {
        let most = (self.memory / SHARE / DIVIDED_BYTES) as usize;
        let mut all = Set::create(self.work)?;
        let mut first = 0;
        for part in self.scene.parts_of(self.mesh) {
            let part = self.scene.some_parts(self.source, part..part + 1)?;
            all.push(&self.frame.items(&part, first))?;
            first += part.indices.len() as u32;
        }
        let splitter = Splitter::new(self.frame.limits, &all.tally);
        let mut triangles = ScratchWriter::create(self.work, "triangles")?;
        let (mut counts, mut boxes) = (Vec::new(), Vec::new());
        // Sets still to be looked at, the next one last.
        let mut open = vec![all.finish()?];
        while let Some((items, tally)) = open.pop() {
            let step = match tally.count <= most {
                true => Step::Piece,
                false => splitter.step(&tally, || binned(&items, &tally))?,
            };
            let is_left: Box<dyn Fn(&Item) -> bool> = match step {
                Step::Piece => {
                    for Piece { triangles: ids, bounds } in
                        splitter.divide(&mut items.load()?, &tally)
                    {
                        triangles.push(&ids)?;
                        counts.push(ids.len() as u32);
                        boxes.push(bounds);
                    }
                    continue;
                }
                Step::Cut(plane) => Box::new(move |item: &Item| plane.is_left(item)),
                Step::Halve(axis) => {
                    let middle = ranked(&items, axis, tally.count as u64 / 2)?;
                    Box::new(move |item: &Item| item.rank(axis) < middle)
                }
            };
            let (mut left, mut right) = (Set::create(self.work)?, Set::create(self.work)?);
            items.for_each(|some| {
                some.iter().try_for_each(|item| {
                    let side = if is_left(item) { &mut left } else { &mut right };
                    side.push(std::slice::from_ref(item))
                })
            })?;
            drop(items);
            open.push(right.finish()?);
            open.push(left.finish()?);
        }
        Ok(Parts { triangles: triangles.finish()?, counts, bounds: boxes })
    }

    /// Hands out the meshes of all pieces, as many at a time as have `most` triangles, with the number of the
    /// first; those that are not wanted are empty.
    fn gathered(
        &self,
        parts: &Parts,
        most: usize,
        is_wanted: impl Fn(usize) -> bool,
        mut out: impl FnMut(usize, Vec<Mesh>) -> Result<(), WorkError>,
    ) -> Result<(), WorkError> {
        let mut triangles = parts.triangles.read()?;
        let mut first = 0;
        while first < parts.counts.len() {
            let mut sum = 0;
            let fits = |&(piece, &count): &(usize, &u32)| {
                sum += if is_wanted(piece) { count as usize } else { 0 };
                sum <= most
            };
            let counts = parts.counts.iter().enumerate().skip(first);
            let few = counts.take_while(fits).count().max(1);
            // (triangle, piece), in the order of the mesh.
            let mut wanted: Vec<(u32, u32)> = Vec::new();
            for (piece, number) in (first..first + few).zip(0..) {
                let ids = triangles.next(parts.counts[piece] as usize)?;
                if is_wanted(piece) {
                    wanted.extend(ids.into_iter().map(|id| (id, number)));
                }
            }
            wanted.par_sort_unstable();
            out(first, self.meshes(&wanted, few)?)?;
            first += few;
        }
        Ok(())
    }

    /// So many meshes of the triangles in `wanted`, each with the number of its mesh.
    fn meshes(&self, wanted: &[(u32, u32)], count: usize) -> Result<Vec<Mesh>, WorkError> {
        let mut meshes = vec![Mesh::default(); count];
        let (mut wanted, mut first) = (wanted, 0u32);
        for part in self.scene.parts_of(self.mesh) {
            let end = first + self.scene.part_triangles(part);
            let (here, behind) = wanted.split_at(wanted.partition_point(|&(id, _)| id < end));
            if !here.is_empty() {
                let mesh = self.scene.some_parts(self.source, part..part + 1)?;
                let gatherer = Gatherer::new(&mesh, &self.frame);
                // By piece; within each in the order of the mesh.
                let mut here: Vec<(u32, u32)> = here.iter().map(|&(id, p)| (p, id)).collect();
                here.par_sort_unstable();
                let groups: Vec<&[(u32, u32)]> = here.chunk_by(|a, b| a.0 == b.0).collect();
                let gather = |local: &mut Local, group: &&[(u32, u32)]| {
                    gatherer.gather(group.iter().map(|&(_, id)| id - first), local)
                };
                let gathered: Vec<Mesh> =
                    groups.par_iter().map_init(HashMap::default, gather).collect();
                for (group, gathered) in groups.iter().zip(&gathered) {
                    meshes[group[0].0 as usize].append(gathered);
                }
            }
            (wanted, first) = (behind, end);
        }
        Ok(meshes)
    }
}

/// Boxes of triangles that are being written.
struct Set {
    items: ScratchWriter<Item>,
    tally: Tally,
}

impl Set {
    fn create(work: &Work) -> Result<Self, WorkError> {
        Ok(Self { items: ScratchWriter::create(work, "boxes")?, tally: Tally::EMPTY })
    }

    fn push(&mut self, items: &[Item]) -> Result<(), WorkError> {
        self.tally = match items {
            [item] => {
                self.tally.add(item);
                self.tally
            }
            _ => self.tally.union(Tally::of(items)),
        };
        self.items.push(items)
    }

    fn finish(self) -> Result<(Scratch<Item>, Tally), WorkError> {
        Ok((self.items.finish()?, self.tally))
    }
}

fn binned(items: &Scratch<Item>, tally: &Tally) -> Result<Bins, WorkError> {
    let mut bins = Bins::new(tally);
    items.for_each(|some| {
        some.iter().for_each(|item| bins.add(item));
        Ok(())
    })?;
    Ok(bins)
}

/// The rank that so many triangles are below: found digit by digit.
fn ranked(items: &Scratch<Item>, axis: usize, mut below: u64) -> Result<u64, WorkError> {
    const DIGIT: u32 = 16;
    let mut found = 0u64;
    for shift in [48, 32, 16, 0] {
        let mut counts = vec![0u64; 1 << DIGIT];
        items.for_each(|some| {
            for item in some {
                let rank = item.rank(axis);
                // What is known of it so far, shifted in two steps lest nothing be left of a word.
                if (rank ^ found) >> shift >> DIGIT == 0 {
                    counts[(rank >> shift & 0xffff) as usize] += 1;
                }
            }
            Ok(())
        })?;
        let mut digit = 0;
        while below >= counts[digit] {
            below -= counts[digit];
            digit += 1;
        }
        found |= (digit as u64) << shift;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bulk::{self, Bulk};
    use crate::options::Options;
    use crate::slice::Slicer;
    use crate::source::{Imported, Section, Sink, SourceMesh};
    use crate::spool::Spool;
    use glam::{DAffine3, DVec3, Vec3};

    /// Waves, a heap of triangles in one place, and two surfaces; in two parts and more.
    fn mesh(side: u32) -> SourceMesh {
        let at = |i: u32| {
            let (x, y) = ((i % (side + 1)) as f32, (i / (side + 1)) as f32);
            [x, y, (x * 0.3).sin() + (y * 0.2).cos()]
        };
        let quad = |i: u32| {
            let a = i % side + i / side * (side + 1);
            [[a, a + 1, a + side + 1], [a + 1, a + side + 2, a + side + 1]]
        };
        let mut positions: Vec<[f32; 3]> = (0..(side + 1) * (side + 1)).map(at).collect();
        // Jumping to and fro, as few exporters do.
        let order = |i: u32| (u64::from(i) * 7919 % u64::from(side * side)) as u32;
        let mut indices: Vec<[u32; 3]> = (0..side * side).flat_map(|i| quad(order(i))).collect();
        let heap = positions.len() as u32;
        positions.extend([[5.0, 5.0, 9.0], [6.0, 5.0, 9.0], [5.0, 6.0, 9.0], [-3e6, 9.0, 1e5]]);
        indices.extend([[heap, heap + 1, heap + 2]; 9000]);
        // One that reaches far away, in the middle of the list.
        indices[777] = [40, heap + 3, 60];
        let end = indices.len() as u32;
        SourceMesh {
            normals: vec![[0.0, 0.6, 0.8]; positions.len()],
            colors: vec![[9, 8, 7, 255]; positions.len()],
            positions,
            indices,
            sections: vec![Section { end: end - 9000, surface: 0 }, Section { end, surface: 1 }],
            ..SourceMesh::default()
        }
    }

    #[test]
    fn the_pieces_are_those_that_are_made_in_memory() {
        let folder = tempfile::tempdir().unwrap();
        let work = Work::open(&folder.path().join("a.occ")).unwrap();
        let mut spool = Spool::create(&work).unwrap();
        let whole = mesh(200);
        spool.mesh(whole.clone()).unwrap();
        let scene = spool.finish(Imported::default()).unwrap();
        let source = Scene::open(&work).unwrap();
        assert!(scene.parts_of(0).len() > 1);
        let options = Options { piece_triangles: 300, ..Options::default() };
        let slicer = Slicer { options: &options, scene_diagonal: 300.0 };
        let samples = || bulk::placed(scene.samples_of(0), &DAffine3::IDENTITY, 1.0);
        let bulk = Bulk::of(samples());
        let mut placement = DAffine3::from_scale(DVec3::new(-1.0, 2.0, 0.5));
        placement.translation = DVec3::new(1e6, 0.0, 3.0);
        for placements in [vec![placement], vec![placement, DAffine3::IDENTITY]] {
            let expected = slicer.pieces(&whole, &placements, bulk);
            for memory in [200_000, 1_000_000, 1 << 24] {
                let frame = slicer.frame(&placements, bulk);
                let giant =
                    Giant { work: &work, scene: &scene, source: &source, mesh: 0, frame, memory };
                let mut file = Appender::create(&work.path("out")).unwrap();
                let mut pieces = Vec::new();
                let spans = giant.pieces(&mut file, |_, piece| {
                    pieces.push(piece);
                    Ok(())
                });
                file.flush().unwrap();
                let file = Records::open(&work.path("out")).unwrap();
                for (piece, span) in pieces.iter_mut().zip(spans.unwrap()) {
                    let seams = file.read(span).unwrap();
                    piece.seams = seams.chunks_exact(8).map(bytemuck::pod_read_unaligned).collect();
                }
                assert!(pieces == expected, "{memory}");
            }
        }
        assert!(expected_files(&work), "scratch files are left");
    }

    fn expected_files(work: &Work) -> bool {
        let entries = std::fs::read_dir(work.path("")).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names == ["lock", "meshes", "out"]
    }

    #[test]
    fn the_rank_of_the_middle_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let work = Work::open(&folder.path().join("a.occ")).unwrap();
        let mut items: Vec<Item> = (0..1000u32)
            .map(|id| Item::of(id, [Vec3::new((id * 37 % 101) as f32 - 50.0, 1.0, 0.0); 3]))
            .collect();
        let mut scratch = ScratchWriter::create(&work, "boxes").unwrap();
        scratch.push(&items).unwrap();
        let scratch = scratch.finish().unwrap();
        for axis in 0..3 {
            items.sort_unstable_by_key(|item| item.rank(axis));
            for below in [0, 1, 500, 999] {
                let found = ranked(&scratch, axis, below).unwrap();
                assert_eq!(found, items[below as usize].rank(axis), "{axis} {below}");
            }
        }
    }
}
