//! Uploading, evicting and uploading again.

use crate::support::{Mesh, backend, draw, lists, shade, view};
use protocol::id::BlobId;
use rand::SeedableRng;
use rand::rngs::StdRng;
use scene::backend::{Backend, Draw, Part, Shading};

fn soups(count: u64, triangles: usize) -> Vec<Mesh> {
    (0..count).map(|seed| Mesh::soup(&mut StdRng::seed_from_u64(seed), triangles)).collect()
}

fn side_by_side(blobs: &[u32]) -> Vec<Draw> {
    let step = 1.0 / (1 << 20) as f32;
    let place =
        |(i, &blob): (usize, &u32)| draw(blob, blob, [step; 3], [i as f32 - 2.0, -0.5, -3.0]);
    blobs.iter().enumerate().map(place).collect()
}

#[test]
fn memory_is_used_again() {
    let Some(mut backend) = backend(96, 96) else { return };
    let view = view(96, 96);
    // Odd triangle counts pad their indices; several buffers are needed for 12 MiB.
    let meshes = soups(16, 14_565);
    let draws = side_by_side(&[3, 8, 12, 15]);
    for (blob, mesh) in meshes.iter().enumerate() {
        mesh.upload(&mut backend, blob as u32);
    }
    let expected = shade(&mut backend, view, &draws);
    assert!(expected.rgba.chunks(4).any(|pixel| pixel != &expected.rgba[..4]));
    for round in 0..6u32 {
        for blob in 0..16 {
            if blob % 3 == round % 3 {
                backend.evict(BlobId(blob));
            }
        }
        for blob in (0..16).rev() {
            if blob % 3 == round % 3 {
                meshes[blob as usize].upload(&mut backend, blob);
            }
        }
        assert!(shade(&mut backend, view, &draws) == expected, "round {round}");
    }
    (0..20).for_each(|blob| backend.evict(BlobId(blob)));
    meshes.iter().enumerate().for_each(|(i, mesh)| mesh.upload(&mut backend, i as u32));
    assert!(shade(&mut backend, view, &draws) == expected, "after evicting everything");
}

#[test]
fn a_blob_may_be_replaced_while_its_picture_is_under_way() {
    let Some(mut backend) = backend(64, 64) else { return };
    let view = view(64, 64);
    let meshes = soups(2, 500);
    let draws = side_by_side(&[0]);
    meshes[1].upload(&mut backend, 0);
    let second = shade(&mut backend, view, &draws);
    meshes[0].upload(&mut backend, 0);
    let first = shade(&mut backend, view, &draws);
    assert!(first != second);
    let (draws, part) = (lists(&draws), Part::WHOLE);
    let pass = scene::backend::Pass::Shade {
        view,
        shading: Shading::default(),
        draws,
        with_depth: true,
        part,
    };
    backend.submit(pass.clone()).unwrap();
    meshes[1].upload(&mut backend, 0);
    backend.submit(pass).unwrap();
    let mut completions = Vec::new();
    while completions.len() < 2 {
        backend.poll(&mut completions).unwrap();
    }
    let pictures: Vec<_> = completions
        .into_iter()
        .map(|completion| match completion {
            scene::backend::Completion::Picture { picture, .. } => picture,
            other => panic!("a picture expected, not {other:?}"),
        })
        .collect();
    assert!(pictures == [first, second]);
}
