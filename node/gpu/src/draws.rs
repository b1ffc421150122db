//! A list of draws as instance data and indexed draw calls.

use crate::geometry_memory::{GeometryMemory, Place};
use crate::mesh_pipelines::{Into, Key, Reads};
use protocol::format::Class;
use scene::backend::Draw;
use shaders::mirror::Instance;
use std::ops::Range;

/// Consecutive draws of one mesh and turn: one instanced call a class.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Run {
    pub(crate) place: Place,
    pub(crate) mirrored: bool,
    pub(crate) instances: Range<u32>,
}

/// All of a part of a pass.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Plan {
    pub(crate) instances: Vec<Instance>,
    /// What is solid, in the order of the draws.
    pub(crate) runs: Vec<Run>,
    /// What blends, in order, each a call of its own: joined, the triangles of one class would overtake
    /// those of another.
    pub(crate) blended: Vec<Run>,
}

/// Instance data of both lists, and the calls over it. `place` finds a mesh.
///
/// A blob that is not resident is the caller's mistake and panics.
pub(crate) fn plan(
    solid: &[Draw],
    blending: &[Draw],
    place: impl Fn(&Draw) -> Option<Place>,
) -> Plan {
    let place = |draw: &Draw| {
        place(draw).unwrap_or_else(|| panic!("blob {} was drawn, never uploaded", draw.blob))
    };
    let mut plan = Plan::default();
    plan.instances.reserve(solid.len() + blending.len());
    for draw in solid {
        let run = plan.push(draw, place(draw));
        match plan.runs.last_mut() {
            Some(last) if last.place == run.place && last.mirrored == run.mirrored => {
                last.instances.end = run.instances.end;
            }
            _ => plan.runs.push(run),
        }
    }
    for draw in blending {
        let run = plan.push(draw, place(draw));
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
            disparity_step: draw.disparity_step,
            picture: place.picture.start,
            side: place.picture.side,
            normals: place.picture.normals,
        });
        Run { place, mirrored: draw.is_mirrored(), instances: at..at + 1 }
    }

    /// The calls for what does not blend, blob by blob and of each class by class. Of `Into::Depth` it is
    /// what is opaque.
    pub(crate) fn solid(&self, into: Into) -> Vec<(Key, Call<'_>)> {
        let wanted = |class: &Class| class.is_opaque() || class.is_mask() && into != Into::Depth;
        let classes = || Class::ALL.into_iter().filter(wanted);
        self.runs
            .chunk_by(|a, b| a.place == b.place)
            .flat_map(|of_blob| {
                classes()
                    .flat_map(move |class| of_blob.iter().filter_map(move |r| r.call(into, class)))
            })
            .collect()
    }

    /// The calls for each stretch of draws of one item, all classes, where none blends.
    pub(crate) fn by_item(&self) -> Vec<Vec<(Key, Call<'_>)>> {
        let item = |run: &Run| self.instances[run.instances.start as usize].item;
        let items = self.blended.chunk_by(|a, b| item(a) == item(b));
        let classes = || Class::ALL.into_iter();
        items
            .map(|runs| {
                let calls =
                    runs.iter().flat_map(|r| classes().filter_map(|c| r.call(Into::Count, c)));
                calls.collect()
            })
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
        let key = Key::new(into, class, self.place.layout, self.mirrored);
        (!indices.is_empty()).then_some((key, Call { run: self, indices }))
    }
}

/// Records calls with their pipelines. The uniform's group and the instance buffer (slot 1) are set;
/// `textures` is group 1 of those that read textures.
pub(crate) fn record<'a>(
    pass: &mut wgpu::RenderPass<'_>,
    memory: &GeometryMemory,
    textures: Option<&wgpu::BindGroup>,
    calls: impl IntoIterator<Item = (&'a wgpu::RenderPipeline, &'a (Key, Call<'a>))>,
) {
    let (mut bound, mut used, mut read) = (None, None, None);
    for (pipeline, (key, Call { run: Run { place, instances, .. }, indices })) in calls {
        let group = match key.reads() {
            Reads::Nothing => None,
            Reads::Textures => textures,
            Reads::Picture => Some(memory.words(place.chunk)),
        };
        if group.is_some() && read != group {
            pass.set_bind_group(1, group, &[]);
            read = group;
        }
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
    use crate::geometry_memory::Picture;
    use protocol::format::vertex::Layout;
    use protocol::id::{BlobId, HlodId};

    fn draw(blob: u32, item: u32) -> Draw {
        let linear = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let (offset, distance) = ([item as f32; 3], item as f32);
        Draw {
            blob: BlobId(blob),
            item: HlodId(item),
            linear,
            offset,
            distance,
            disparity_step: 0.0,
        }
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
            layout: if draw.blob.0 < 5 { Layout::Plain } else { Layout::Textured },
            picture: Picture::default(),
        })
    }

    #[test]
    fn nothing_makes_no_call() {
        let plan = plan(&[], &[], place);
        assert_eq!(plan, Plan::default());
        assert!(plan.solid(Into::Picture).is_empty() && plan.blending(Into::Picture).is_empty());
    }

    #[test]
    fn only_neighbours_of_one_blob_and_turn_join() {
        let mut draws: Vec<Draw> =
            [(1, 0), (1, 1), (2, 2), (1, 3), (1, 4)].map(|(b, i)| draw(b, i)).into();
        draws.extend([mirrored(1, 5), mirrored(1, 6)]);
        let plan = plan(&draws, &[], place);
        let items: Vec<_> = plan.instances.iter().map(|i| i.item).collect();
        assert_eq!(items, [0, 1, 2, 3, 4, 5, 6]);
        let calls: Vec<_> =
            plan.runs.iter().map(|r| (r.place.base_vertex, r.instances.clone())).collect();
        assert_eq!(calls, [(1, 0..2), (2, 2..3), (1, 3..5), (1, 5..7)]);
        assert_eq!(plan.solid(Into::Depth).len(), 4);
        assert!(plan.blended.is_empty());
    }

    #[test]
    fn classes_of_a_blob_follow_each_other_and_what_blends_keeps_its_order() {
        let draws = [draw(5, 1), draw(5, 2), mirrored(5, 3), draw(6, 9)];
        let plan = plan(&draws, &[draws[3], draws[0]], place);
        let seen = |calls: Vec<(Key, Call<'_>)>| -> Vec<_> {
            let seen = |(_, call): (_, Call<'_>)| (call.indices, call.run.instances.clone());
            calls.into_iter().map(seen).collect()
        };
        let (single, double) = (100..103, 103..109);
        let of_blob_5 =
            [&single, &single, &double, &double].into_iter().zip([0..2, 2..3, 0..2, 2..3]);
        let of_blob_6 = [&single, &double].into_iter().zip([3..4, 3..4]);
        let expected: Vec<_> = of_blob_5.chain(of_blob_6).map(|(i, at)| (i.clone(), at)).collect();
        assert_eq!(seen(plan.solid(Into::Depth)), expected);
        assert_eq!(plan.solid(Into::Items).len(), 12);
        let items: Vec<_> = plan.instances[4..].iter().map(|i| i.item).collect();
        assert_eq!(items, [9, 1]);
        let blended = seen(plan.blending(Into::Picture));
        let expected = [(118..121, 4..5), (121..127, 4..5), (118..121, 5..6), (121..127, 5..6)];
        assert_eq!(blended, expected);
    }

    #[test]
    #[should_panic(expected = "never uploaded")]
    fn a_missing_blob_is_our_mistake() {
        plan(&[draw(11, 0)], &[], place);
    }
}
