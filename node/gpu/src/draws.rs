//! A list of draws as instance data and indexed draw calls.

use crate::geometry_memory::{GeometryMemory, Place};
use crate::mesh_pipelines::{Into, Key};
use protocol::format::Class;
use scene::backend::{Draw, far_to_near};
use shaders::mirror::Instance;
use std::ops::Range;

/// Consecutive draws of one mesh: one instanced call a class.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Run {
    pub(crate) place: Place,
    pub(crate) mirrored: bool,
    pub(crate) instances: Range<u32>,
}

/// All of a pass.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Plan {
    pub(crate) instances: Vec<Instance>,
    /// In the order of the draws.
    pub(crate) runs: Vec<Run>,
    /// What blends, far to near, each a call of its own: joined, the triangles of one class would
    /// overtake those of another.
    pub(crate) blended: Vec<Run>,
}

/// Instance data and the calls over it. `place` finds a mesh.
///
/// A blob that is not resident is the caller's mistake and panics.
pub(crate) fn plan(draws: &[Draw], place: impl Fn(&Draw) -> Option<Place>) -> Plan {
    let place = |draw: &Draw| {
        place(draw).unwrap_or_else(|| panic!("blob {} was drawn, never uploaded", draw.blob))
    };
    let places: Vec<Place> = draws.iter().map(place).collect();
    let mut plan = Plan::default();
    plan.instances.reserve(draws.len());
    for (draw, &place) in draws.iter().zip(&places) {
        let run = plan.push(draw, place);
        match plan.runs.last_mut() {
            Some(last) if last.place == place && last.mirrored == run.mirrored => {
                last.instances.end = run.instances.end;
            }
            _ => plan.runs.push(run),
        }
    }
    for index in far_to_near(draws, |index| places[index].blends()) {
        let run = plan.push(&draws[index], places[index]);
        plan.blended.push(run);
    }
    plan
}

impl Plan {
    /// Appends one instance; the run of it alone.
    fn push(&mut self, draw: &Draw, place: Place) -> Run {
        let at = self.instances.len() as u32;
        self.instances.push(Instance {
            column_x: draw.linear[0],
            column_y: draw.linear[1],
            column_z: draw.linear[2],
            offset: draw.offset,
            item: draw.item.0,
        });
        Run { place, mirrored: draw.is_mirrored(), instances: at..at + 1 }
    }

    /// The calls for what does not blend, one class after the other: so the order of what is left of a
    /// list does not depend on what is left out. Of `Into::Depth` it is what is opaque.
    pub(crate) fn solid(&self, into: Into) -> Vec<(Key, Call<'_>)> {
        let wanted = |class: &Class| class.is_opaque() || class.is_mask() && into != Into::Depth;
        let classes = Class::ALL.into_iter().filter(wanted);
        classes
            .flat_map(|class| self.runs.iter().filter_map(move |r| r.call(into, class)))
            .collect()
    }

    /// The calls for what blends.
    pub(crate) fn blending(&self, into: Into) -> Vec<(Key, Call<'_>)> {
        let classes = || Class::ALL.into_iter().filter(|class| class.is_blend());
        self.blended.iter().flat_map(|r| classes().filter_map(|c| r.call(into, c))).collect()
    }
}

/// One indexed draw call.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Call<'a> {
    run: &'a Run,
    indices: Range<u32>,
}

impl Run {
    fn call(&self, into: Into, class: Class) -> Option<(Key, Call<'_>)> {
        let indices = self.place.indices_of(class);
        let key = Key::new(into, class, self.place.textured, self.mirrored);
        (!indices.is_empty()).then_some((key, Call { run: self, indices }))
    }
}

/// Records calls with their pipelines. The uniform's group and the instance buffer (slot 1) are set.
pub(crate) fn record<'a>(
    pass: &mut wgpu::RenderPass<'_>,
    memory: &GeometryMemory,
    calls: impl IntoIterator<Item = (&'a wgpu::RenderPipeline, &'a Call<'a>)>,
) {
    let (mut bound, mut used) = (None, None);
    for (pipeline, Call { run: Run { place, instances, .. }, indices }) in calls {
        if used != Some(pipeline) {
            pass.set_pipeline(pipeline);
            used = Some(pipeline);
        }
        if bound != Some(place.chunk) {
            let buffer = memory.buffer(place.chunk);
            pass.set_vertex_buffer(0, buffer.slice(..));
            pass.set_index_buffer(buffer.slice(..), wgpu::IndexFormat::Uint16);
            bound = Some(place.chunk);
        }
        pass.draw_indexed(indices.clone(), place.base_vertex, instances.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::id::{BlobId, HlodId};

    fn draw(blob: u32, item: u32) -> Draw {
        let linear = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let (offset, distance) = ([item as f32; 3], item as f32);
        Draw { blob: BlobId(blob), item: HlodId(item), linear, offset, distance }
    }

    fn mirrored(blob: u32, item: u32) -> Draw {
        let draw = draw(blob, item);
        Draw { linear: [[-1.0, 0.0, 0.0], draw.linear[1], draw.linear[2]], ..draw }
    }

    /// Blobs from 5 on hold all classes.
    fn place(draw: &Draw) -> Option<Place> {
        (draw.blob.0 < 10).then_some(Place {
            chunk: 0,
            base_vertex: draw.blob.0 as i32,
            first_index: 100,
            classes: if draw.blob.0 < 5 { [0, 1, 0, 0, 0, 0] } else { [1, 2, 1, 2, 1, 2] },
            textured: draw.blob.0 >= 5,
        })
    }

    #[test]
    fn nothing_makes_no_call() {
        let plan = plan(&[], place);
        assert_eq!(plan, Plan::default());
        assert!(plan.solid(Into::Picture).is_empty() && plan.blending(Into::Picture).is_empty());
    }

    #[test]
    fn only_neighbours_of_one_blob_and_turn_join() {
        let mut draws: Vec<Draw> =
            [(1, 0), (1, 1), (2, 2), (1, 3), (1, 4)].map(|(b, i)| draw(b, i)).into();
        draws.extend([mirrored(1, 5), mirrored(1, 6)]);
        let plan = plan(&draws, place);
        let items: Vec<_> = plan.instances.iter().map(|i| i.item).collect();
        assert_eq!(items, [0, 1, 2, 3, 4, 5, 6]);
        let calls: Vec<_> =
            plan.runs.iter().map(|r| (r.place.base_vertex, r.instances.clone())).collect();
        assert_eq!(calls, [(1, 0..2), (2, 2..3), (1, 3..5), (1, 5..7)]);
        assert_eq!(plan.solid(Into::Depth).len(), 4);
        assert!(plan.blended.is_empty());
    }

    #[test]
    fn classes_follow_each_other_and_what_blends_comes_far_to_near() {
        let plan = plan(&[draw(5, 1), draw(5, 2), draw(6, 9)], place);
        let seen = |calls: Vec<(Key, Call<'_>)>| -> Vec<_> {
            let seen = |(_, call): (_, Call<'_>)| (call.indices, call.run.instances.clone());
            calls.into_iter().map(seen).collect()
        };
        let depth = seen(plan.solid(Into::Depth));
        assert_eq!(depth, [(100..103, 0..2), (100..103, 2..3), (103..109, 0..2), (103..109, 2..3)]);
        assert_eq!(plan.solid(Into::Items).len(), 8);
        let items: Vec<_> = plan.instances[3..].iter().map(|i| i.item).collect();
        assert_eq!(items, [9, 2, 1]);
        let blended = seen(plan.blending(Into::Picture));
        assert_eq!(blended[..3], [(118..121, 3..4), (121..127, 3..4), (118..121, 4..5)]);
    }

    #[test]
    #[should_panic(expected = "never uploaded")]
    fn a_missing_blob_is_our_mistake() {
        plan(&[draw(11, 0)], place);
    }
}
