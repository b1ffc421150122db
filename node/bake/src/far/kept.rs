//! A finished cell as it is kept in the working folder.

use super::cell::FarFieldOf;
use super::summary::CellSummary;
use crate::bytes::{Decoder, Encoder, Torn};
use farfield::cube::{BakedCube, BakedFace};
use farfield::depth_mesh::simplify::FaceMesh;
use farfield::patches::{BakedPatch, Window};
use farfield::picture::StoredPicture;
use glam::DVec3;

/// In place of what is not there.
const NONE: u64 = u64::MAX;

pub(super) fn encode(made: &FarFieldOf) -> Vec<u8> {
    let mut out = Encoder::default();
    put_summary(&mut out, &made.summary);
    out.put(made.cubes.len() as u64);
    for cube in &made.cubes {
        out.put(cube.eye.to_array());
        out.put(cube.parent.map_or(NONE, |parent| parent as u64));
        for face in &cube.faces {
            out.put(u8::from(face.is_some()));
            face.iter().for_each(|face| put_face(&mut out, face));
        }
    }
    out.0
}

/// What [`encode`] gave.
pub(super) fn decode(bytes: &[u8]) -> Result<FarFieldOf, Torn> {
    let mut from = Decoder(bytes);
    let summary = take_summary(&mut from)?;
    let mut cubes = Vec::new();
    for _ in 0..from.take_count()? {
        let eye = DVec3::from_array(from.take()?);
        let parent = Some(from.take::<u64>()?).filter(|&parent| parent != NONE);
        let mut faces: [Option<BakedFace>; 6] = Default::default();
        for face in &mut faces {
            if from.take::<u8>()? != 0 {
                *face = Some(take_face(&mut from)?);
            }
        }
        cubes.push(BakedCube { eye, parent: parent.map(|parent| parent as usize), faces });
    }
    from.end()?;
    Ok(FarFieldOf { cubes, summary })
}

fn put_summary(out: &mut Encoder, summary: &CellSummary) {
    out.put([summary.min, summary.max]);
    out.put(u8::from(summary.kept));
    out.put([summary.samples as u64, summary.cubes as u64]);
    out.put_slice(&summary.objective);
    out.put([summary.points, summary.redundant, summary.triangles, summary.bytes]);
    out.put([summary.cubes_in_view, summary.geometry_in_view, summary.near_triangles]);
    out.put(summary.seconds);
}

fn take_summary(from: &mut Decoder<'_>) -> Result<CellSummary, Torn> {
    let [min, max] = from.take()?;
    let kept = from.take::<u8>()? != 0;
    let [samples, cubes] = from.take::<[u64; 2]>()?.map(|count| count as usize);
    let objective = from.take_slice()?;
    let [points, redundant, triangles, bytes] = from.take()?;
    let [cubes_in_view, geometry_in_view, near_triangles] = from.take()?;
    let seconds = from.take()?;
    Ok(CellSummary {
        min,
        max,
        kept,
        samples,
        cubes,
        objective,
        points,
        redundant,
        triangles,
        cubes_in_view,
        geometry_in_view,
        near_triangles,
        bytes,
        seconds,
    })
}

fn put_face(out: &mut Encoder, BakedFace { mesh, patches }: &BakedFace) {
    out.put_slice(&mesh.vertices);
    out.put_slice(&mesh.triangles);
    out.put([mesh.step, mesh.error_px]);
    out.put(patches.len() as u64);
    for BakedPatch { triangles, window, picture } in patches {
        out.put([triangles.start as u64, triangles.end as u64]);
        out.put([window.at[0], window.at[1], window.across]);
        out.put_slice(&picture.table);
        out.put_slice(&picture.tiles);
        out.put(u8::from(picture.normals.is_some()));
        picture.normals.iter().for_each(|normals| out.put_slice(normals));
    }
}

fn take_face(from: &mut Decoder<'_>) -> Result<BakedFace, Torn> {
    let (vertices, triangles) = (from.take_slice()?, from.take_slice()?);
    let [step, error_px] = from.take()?;
    let mesh = FaceMesh { vertices, triangles, step, error_px };
    let mut patches = Vec::new();
    for _ in 0..from.take_count()? {
        let [start, end] = from.take::<[u64; 2]>()?.map(|at| at as usize);
        let [left, top, across] = from.take()?;
        let (table, tiles) = (from.take_slice()?, from.take_slice()?);
        let has_normals = from.take::<u8>()? != 0;
        let normals = has_normals.then(|| from.take_slice()).transpose()?;
        let picture = StoredPicture { table, tiles, normals };
        let window = Window { at: [left, top], across };
        patches.push(BakedPatch { triangles: start..end, window, picture });
    }
    Ok(BakedFace { mesh, patches })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn made() -> FarFieldOf {
        let patch = |triangles, normals| BakedPatch {
            triangles,
            window: Window { at: [3, 4], across: 5 },
            picture: StoredPicture { table: vec![0, 1], tiles: vec![7; 128], normals },
        };
        let mesh = FaceMesh {
            vertices: vec![[1, 2, 3], [4, 5, 6], [7, 8, 9]],
            triangles: vec![[0, 1, 2], [2, 1, 0]],
            step: 0.125,
            error_px: 0.3,
        };
        let patches = vec![patch(0..1, None), patch(1..2, Some(vec![9; 128]))];
        let mut faces: [Option<BakedFace>; 6] = Default::default();
        faces[4] = Some(BakedFace { mesh, patches });
        let intra = BakedCube { eye: DVec3::new(0.1, 0.2, 0.3), parent: None, faces };
        let delta = BakedCube { parent: Some(0), faces: Default::default(), ..intra.clone() };
        let summary = CellSummary {
            min: [0.1, 0.2, 0.3],
            max: [1.1, 1.2, 1.3],
            kept: true,
            samples: 3,
            cubes: 2,
            objective: vec![0.9, 0.1],
            points: 1,
            redundant: 2,
            triangles: 3,
            cubes_in_view: 4,
            geometry_in_view: 5,
            near_triangles: 6,
            bytes: 7,
            seconds: [0.7, 0.8, 0.9],
        };
        FarFieldOf { cubes: vec![intra, delta], summary }
    }

    #[test]
    fn a_cell_comes_back_as_it_was_and_torn_not_at_all() {
        let made = made();
        let bytes = encode(&made);
        assert_eq!(decode(&bytes), Ok(made));
        for end in 0..bytes.len() {
            assert!(decode(&bytes[..end]).is_err(), "cut to {end}");
        }
        assert!(decode(&[&bytes[..], &[0]].concat()).is_err());
    }
}
