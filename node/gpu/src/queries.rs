//! Boxes and meshes against the occlusion depth: hardware queries, or one draw in which boxes mark themselves.

use crate::awaited::Awaited;
use crate::backend::Context;
use crate::device::Device;
use crate::readback::Readback;
use crate::targets::{Target, read_depth};
use scene::backend::{BackendError, BoxQuery};
use shaders::BOX_VERTICES;
use shaders::mirror::BoxInstance;

/// Queries of a set: WebGPU's limit, and the grain in which answers stream.
const BATCH: usize = 4096;
/// Queries of a render pass on hardware, where each pass costs.
const PASS: usize = 256;
/// Queries of a render pass of Mesa's software driver, which counts too many samples in passes of far more, and
/// rasterises one pass while it takes in the next: with 32 a cull took 0.68 of its time with 256.
const SOFTWARE_PASS: usize = 32;
const ANSWER_BYTES: u64 = 8;

/// One query set and its way back, used again and again.
pub(crate) struct QueryBatch {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    pub(crate) answers: Readback,
}

impl QueryBatch {
    fn new(device: &Device) -> Self {
        let bytes = BATCH as u64 * ANSWER_BYTES;
        Self {
            set: device.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: None,
                ty: wgpu::QueryType::Occlusion,
                count: BATCH as u32,
            }),
            resolved: device.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("query answers"),
                size: bytes,
                usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            }),
            answers: Readback::new(device, bytes),
        }
    }

    /// Whether any sample passed, for the first `count` queries. Portable code may ask no more.
    pub(crate) fn read(&self, count: usize) -> Result<Vec<bool>, BackendError> {
        self.answers.read(count as u64 * ANSWER_BYTES, |bytes| {
            bytes.chunks_exact(ANSWER_BYTES as usize).map(|n| n.iter().any(|&b| b != 0)).collect()
        })
    }
}

/// Boxes as the shaders read them.
pub(crate) fn instances(boxes: &[BoxQuery]) -> Vec<BoxInstance> {
    boxes.iter().map(|b| BoxInstance { least: b.min, greatest: b.max }).collect()
}

/// Submits one occlusion query a box, a batch at a time (Manocha, section 4.2), and returns what is
/// awaited, in order. `boxes` is not 0; `instances` holds them.
pub(crate) fn submit_queries(
    context: &Context<'_>,
    instances: &wgpu::Buffer,
    boxes: usize,
    pool: &mut Vec<QueryBatch>,
) -> Vec<(wgpu::SubmissionIndex, Awaited)> {
    let pipelines = context.pipelines;
    let prepare = |pass: &mut wgpu::RenderPass<'_>| {
        pass.set_pipeline(&pipelines.query);
        pass.set_bind_group(0, &pipelines.frame_group, &[]);
        pass.set_vertex_buffer(0, instances.slice(..));
    };
    submit(context, boxes, pool, prepare, |pass, of| {
        pass.draw(0..BOX_VERTICES, of as u32..of as u32 + 1);
    })
}

/// Submits `queries` occlusion queries, more than 0, against the occlusion depth; `prepare` begins a render pass,
/// `draw` draws what one of them counts. Returns what is awaited, in order.
pub(crate) fn submit(
    context: &Context<'_>,
    queries: usize,
    pool: &mut Vec<QueryBatch>,
    prepare: impl Fn(&mut wgpu::RenderPass<'_>),
    draw: impl Fn(&mut wgpu::RenderPass<'_>, usize),
) -> Vec<(wgpu::SubmissionIndex, Awaited)> {
    let Context { device, targets, .. } = context;
    let per_pass = if device.is_software { SOFTWARE_PASS } else { PASS };
    let mut submitted = Vec::new();

    for first in (0..queries).step_by(BATCH) {
        let count = BATCH.min(queries - first);
        let mut batch = pool.pop().unwrap_or_else(|| QueryBatch::new(device));
        let mut encoder = device.device.create_command_encoder(&Default::default());

        for start in (0..count).step_by(per_pass) {
            let mut pass = box_pass(&mut encoder, &targets.occlusion, Some(&batch.set));
            prepare(&mut pass);
            for query in start..(start + per_pass).min(count) {
                pass.begin_occlusion_query(query as u32);
                draw(&mut pass, first + query);
                pass.end_occlusion_query();
            }
        }

        let bytes = count as u64 * ANSWER_BYTES;
        encoder.resolve_query_set(&batch.set, 0..count as u32, &batch.resolved, 0);
        encoder.copy_buffer_to_buffer(&batch.resolved, 0, batch.answers.buffer(), 0, bytes);
        let submission = device.queue.submit([encoder.finish()]);
        batch.answers.start();
        let last = first + count == queries;
        submitted.push((submission, Awaited::Queries { first, count, last, batch }));
    }
    submitted
}

/// Submits one draw of all boxes, whose fragments store a mark for theirs. `boxes` is not empty.
///
/// Errors: `Unsupported` where the device cannot, or the marks exceed one binding.
pub(crate) fn submit_marks(
    context: &Context<'_>,
    instances: &wgpu::Buffer,
    boxes: usize,
) -> Result<(wgpu::SubmissionIndex, Awaited), BackendError> {
    let Context { device, pipelines, targets } = context;
    let pipeline = pipelines.mark.as_ref().ok_or_else(|| {
        device.unsupported("testing all boxes in one draw; use occlusion queries".into())
    })?;
    let bytes = boxes as u64 * 4;
    let limit = device.limits.max_storage_buffer_binding_size;
    if bytes > limit {
        return Err(device.unsupported(format!("marks of {boxes} boxes; it binds {limit} bytes")));
    }
    // A new buffer starts with zeros.
    let marks = device.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("box marks"),
        size: bytes,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    });
    let group = device.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipelines.mark_group_layout,
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: pipelines.frame.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 1, resource: marks.as_entire_binding() },
        ],
    });
    let mut answers = Readback::new(device, bytes);
    let mut encoder = device.device.create_command_encoder(&Default::default());
    let mut pass = box_pass(&mut encoder, &targets.occlusion, None);
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, &group, &[]);
    pass.set_vertex_buffer(0, instances.slice(..));
    pass.draw(0..BOX_VERTICES, 0..boxes as u32);
    drop(pass);
    encoder.copy_buffer_to_buffer(&marks, 0, answers.buffer(), 0, bytes);
    let submission = device.queue.submit([encoder.finish()]);
    answers.start();
    Ok((submission, Awaited::Marks { count: boxes, answers }))
}

/// A pass that can only read the depth.
fn box_pass<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    depth: &Target,
    queries: Option<&wgpu::QuerySet>,
) -> wgpu::RenderPass<'a> {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("boxes"),
        depth_stencil_attachment: Some(read_depth(depth)),
        occlusion_query_set: queries,
        ..Default::default()
    })
}
