//! A list of draws as instance data and indexed draw calls.

use crate::geometry_memory::{GeometryMemory, Place};
use scene::backend::Draw;
use shaders::mirror::Instance;
use std::ops::Range;

/// Consecutive draws of one mesh: one instanced call.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Run {
    pub(crate) place: Place,
    pub(crate) instances: Range<u32>,
}

/// Instance data in the order given, and the calls over it. `place` finds a mesh.
///
/// A blob that is not resident is the caller's mistake and panics.
pub(crate) fn runs(
    draws: &[Draw],
    place: impl Fn(&Draw) -> Option<Place>,
) -> (Vec<Instance>, Vec<Run>) {
    let mut runs: Vec<Run> = Vec::new();
    let mut instances = Vec::with_capacity(draws.len());
    for draw in draws {
        let place =
            place(draw).unwrap_or_else(|| panic!("blob {} was drawn, never uploaded", draw.blob));
        let at = instances.len() as u32;
        instances.push(Instance {
            column_x: draw.linear[0],
            column_y: draw.linear[1],
            column_z: draw.linear[2],
            offset: draw.offset,
            item: draw.item.0,
        });
        match runs.last_mut() {
            Some(run) if run.place == place => run.instances.end = at + 1,
            _ => runs.push(Run { place, instances: at..at + 1 }),
        }
    }
    (instances, runs)
}

/// Records the calls. The pipeline, its bind group and the instance buffer (slot 1) are set already.
pub(crate) fn record(pass: &mut wgpu::RenderPass<'_>, memory: &GeometryMemory, runs: &[Run]) {
    let mut bound = None;
    for Run { place, instances } in runs.iter().filter(|run| run.place.indices > 0) {
        if bound != Some(place.chunk) {
            let buffer = memory.buffer(place.chunk);
            pass.set_vertex_buffer(0, buffer.slice(..));
            pass.set_index_buffer(buffer.slice(..), wgpu::IndexFormat::Uint16);
            bound = Some(place.chunk);
        }
        let indices = place.first_index..place.first_index + place.indices;
        pass.draw_indexed(indices, place.base_vertex, instances.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::id::{BlobId, HlodId};

    fn draw(blob: u32, item: u32) -> Draw {
        let linear = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        Draw { blob: BlobId(blob), item: HlodId(item), linear, offset: [item as f32; 3] }
    }

    fn place(draw: &Draw) -> Option<Place> {
        (draw.blob.0 < 10).then_some(Place {
            chunk: 0,
            base_vertex: draw.blob.0 as i32,
            first_index: 0,
            indices: 3,
        })
    }

    #[test]
    fn nothing_makes_no_call() {
        assert_eq!(runs(&[], place), (vec![], vec![]));
    }

    #[test]
    fn only_neighbours_of_one_blob_join() {
        let draws = [(1, 0), (1, 1), (2, 2), (1, 3), (1, 4)].map(|(b, i)| draw(b, i));
        let (instances, runs) = runs(&draws, place);
        assert_eq!(instances.iter().map(|i| i.item).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
        let calls: Vec<_> =
            runs.iter().map(|r| (r.place.base_vertex, r.instances.clone())).collect();
        assert_eq!(calls, [(1, 0..2), (2, 2..3), (1, 3..5)]);
    }

    #[test]
    #[should_panic(expected = "never uploaded")]
    fn a_missing_blob_is_our_mistake() {
        runs(&[draw(11, 0)], place);
    }
}
