//! Nothing to draw, nothing to test, odd and impossible sizes, bytes that are no blob.

use crate::support::{Mesh, backend, draw, items, occluders, plain_blob, shade, view, visible};
use gpu::{Adapter, WgpuBackend};
use protocol::format::Blob;
use protocol::id::BlobId;
use protocol::settings::{Cull, PictureSize};
use scene::backend::{Backend, BackendError, BoxQuery, NO_ITEM, UNLIMITED, Upload};
use scene::occludee::Rules;

#[test]
fn nothing_gives_sky_and_no_answers() {
    let Some(mut backend) = backend(7, 333) else { return };
    let view = view(7, 333);
    let mut completions = Vec::new();
    backend.poll(&mut completions).unwrap();
    assert_eq!(completions, []);
    occluders(&mut backend, view, &[]);
    for method in [Cull::Queries, Cull::Boxes] {
        assert_eq!(visible(&mut backend, view, &[], method), [false; 0]);
    }
    assert_eq!(items(&mut backend, view, &[]), vec![NO_ITEM; 7 * 333]);
    let picture = shade(&mut backend, view, &[]);
    assert_eq!(picture.depth, Some(vec![0.0; 7 * 333]));
    assert_eq!(picture.rgba.len(), 4 * 7 * 333);
    assert!(picture.rgba.chunks(4).all(|pixel| pixel == &picture.rgba[..4]));
    // Linear 0.60, 0.70, 0.82 in sRGB.
    for (byte, expected) in picture.rgba.iter().zip([203, 218, 234, 255]) {
        assert!(byte.abs_diff(expected) <= 1, "{:?}", &picture.rgba[..4]);
    }
}

#[test]
fn a_blob_of_nothing_draws_nothing() {
    let Some(mut backend) = backend(8, 8) else { return };
    let square = Mesh::square([0.0, 0.0, 1.0], u32::MAX);
    assert_eq!(backend.upload(BlobId(0), &plain_blob(0, 0), &[]).unwrap(), Upload::Done);
    Mesh { vertices: square.vertices, indices: vec![] }.upload(&mut backend, 1);
    let draws = [0, 1].map(|blob| draw(blob, blob, [1.0; 3], [-0.5, -0.5, -1.0]));
    assert_eq!(items(&mut backend, view(8, 8), &draws), [NO_ITEM; 64]);
}

#[test]
fn one_pixel_is_a_picture() {
    let Some(mut backend) = backend(1, 1) else { return };
    Mesh::square([0.0, 0.0, 1.0], u32::MAX).upload(&mut backend, 0);
    let draws = [draw(0, 9, [2.0; 3], [-1.0, -1.0, -1.0])];
    assert_eq!(items(&mut backend, view(1, 1), &draws), [9]);
}

#[test]
fn the_size_may_change_between_passes() {
    let Some(mut backend) = backend(64, 64) else { return };
    Mesh::square([0.0, 0.0, 1.0], u32::MAX).upload(&mut backend, 0);
    let wall = [draw(0, 3, [8.0; 3], [-4.0, -4.0, -1.0])];
    let behind = [BoxQuery { min: [-0.5, -0.5, -3.0], max: [0.5, 0.5, -2.0] }];
    let mut hidden = |size: u32, with_wall: bool| {
        if with_wall {
            occluders(&mut backend, view(size, size), &wall);
        }
        !visible(&mut backend, view(size, size), &behind, Cull::Queries)[0]
    };
    assert!(!hidden(64, false), "nothing is hidden before the first occluder pass");
    assert!(hidden(64, true));
    assert!(!hidden(33, false), "nothing is hidden by an occluder pass of another size");
    assert!(hidden(33, true));
    assert_eq!(items(&mut backend, view(5, 3), &wall), [3; 15]);
}

#[test]
fn impossible_sizes_are_refused() {
    if backend(1, 1).is_none() {
        return;
    }
    for (width, height) in [(0, 4), (4, 0), (1 << 20, 4), (4, u32::MAX)] {
        let size = PictureSize { width, height };
        let made = WgpuBackend::new(size, Adapter::Any, &Rules::default(), UNLIMITED);
        assert!(matches!(made.err(), Some(BackendError::Unsupported { .. })), "{width}x{height}");
    }
}

#[test]
fn bytes_that_are_no_blob_are_refused() {
    let Some(mut backend) = backend(4, 4) else { return };
    let bytes = Mesh::cube(0).bytes();
    let mut refused = |blob: Blob, bytes: &[u8]| {
        let result = backend.upload(BlobId(0), &blob, bytes);
        matches!(result, Err(BackendError::Unsupported { .. }))
    };
    let classes = [u32::MAX; 6];
    assert!(refused(Blob { classes, ..plain_blob(8, 12) }, &bytes));
    assert!(refused(Blob { layout: 1, ..plain_blob(8, 12) }, &bytes));
    assert!(refused(Blob { layout: 2, ..plain_blob(8, 12) }, &bytes));
    let mut upload =
        |vertices, triangles, bytes: &[u8]| refused(plain_blob(vertices, triangles), bytes);
    assert!(upload(8, 12, &bytes[..bytes.len() - 1]));
    assert!(upload(8, 13, &bytes));
    assert!(upload(u32::MAX, u32::MAX, &bytes));
    assert!(upload(0, 0, &bytes));
    assert!(!upload(8, 12, &bytes));
}
