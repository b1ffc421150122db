//! The backend: takes passes, hands back completions.

use crate::awaited::{Awaited, Pending};
use crate::device::{Adapter, Device};
use crate::draws;
use crate::geometry_memory::GeometryMemory;
use crate::pipelines::Pipelines;
use crate::queries::{self, QueryBatch};
use crate::readback::{Readback, Signal};
use crate::stream_buffer::StreamBuffer;
use crate::targets::{Target, Targets, cleared_depth};
use protocol::id::BlobId;
use protocol::settings::{Cull, PictureSize};
use protocol::telemetry::BackendInfo;
use scene::backend::{
    Backend, BackendError, BoxQuery, Completion, Draw, NO_ITEM, Pass, Ticket, View, light,
};
use shaders::mirror::Frame;
use std::collections::VecDeque;

/// Draws through a graphics driver.
///
/// A pass whose view has another size than the one before gets new targets, and the occlusion depth
/// starts empty: boxes are visible then, until the next occluder pass.
pub struct WgpuBackend {
    device: Device,
    pipelines: Pipelines,
    targets: Targets,
    memory: GeometryMemory,
    instances: StreamBuffer,
    boxes: StreamBuffer,
    query_pool: Vec<QueryBatch>,
    pending: VecDeque<Pending>,
    next_ticket: u64,
}

/// What recording a pass needs to read.
pub(crate) struct Context<'a> {
    pub(crate) device: &'a Device,
    pub(crate) pipelines: &'a Pipelines,
    pub(crate) targets: &'a Targets,
}

impl WgpuBackend {
    /// Opens an adapter and compiles the pipelines. `inclusive_depth_test` is the rule of the box tests:
    /// a box at the very depth of an occluder counts as visible, without which an occluder hides its own
    /// box; `false` serves tests alone.
    ///
    /// Errors: `NoAdapter`, `Unsupported` for a size beyond the adapter's limits, `Device`.
    pub fn new(
        size: PictureSize,
        choice: Adapter,
        inclusive_depth_test: bool,
    ) -> Result<Self, BackendError> {
        let device = Device::open(choice)?;
        let targets = Targets::new(&device, size)?;
        let pipelines = Pipelines::new(&device, inclusive_depth_test);
        device.fault.check()?;
        Ok(Self {
            device,
            pipelines,
            targets,
            memory: GeometryMemory::default(),
            instances: StreamBuffer::default(),
            boxes: StreamBuffer::default(),
            query_pool: Vec::new(),
            pending: VecDeque::new(),
            next_ticket: 0,
        })
    }

    /// Brings targets and uniform to a view.
    fn begin(&mut self, view: &View) -> Result<(), BackendError> {
        if view.size != self.targets.size {
            self.targets = Targets::new(&self.device, view.size)?;
        }
        let frame = Frame {
            clip_from_eye: view.clip_from_eye,
            sun: light::sun_direction(),
            ambient: light::AMBIENT,
            diffuse: light::SUN,
            padding: [0.0; 3],
        };
        self.device.queue.write_buffer(&self.pipelines.frame, 0, bytemuck::bytes_of(&frame));
        Ok(())
    }

    /// Clears and draws, and leaves the encoder open for copies.
    fn draw(
        &mut self,
        pipeline: impl Fn(&Pipelines) -> &wgpu::RenderPipeline,
        color: impl for<'a> Fn(&'a Targets, &Device) -> Option<(&'a Target, wgpu::Color)>,
        depth: impl for<'a> Fn(&'a Targets, &Device) -> &'a Target,
        draws: &[Draw],
    ) -> wgpu::CommandEncoder {
        let (instances, runs) = draws::runs(draws, |draw| self.memory.place(draw.blob));
        let mut encoder = self.device.device.create_command_encoder(&Default::default());
        let color = color(&self.targets, &self.device).map(|(target, clear)| {
            Some(wgpu::RenderPassColorAttachment {
                view: &target.view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(clear),
                    store: wgpu::StoreOp::Store,
                },
            })
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("draws"),
            color_attachments: color.as_slice(),
            depth_stencil_attachment: Some(cleared_depth(depth(&self.targets, &self.device))),
            ..Default::default()
        });
        if !instances.is_empty() {
            let buffer = self.instances.write(&self.device, bytemuck::cast_slice(&instances));
            pass.set_pipeline(pipeline(&self.pipelines));
            pass.set_bind_group(0, &self.pipelines.frame_group, &[]);
            pass.set_vertex_buffer(1, buffer.slice(..));
            draws::record(&mut pass, &self.memory, &runs);
        }
        drop(pass);
        encoder
    }

    fn occluders(&mut self, draws: &[Draw]) -> (wgpu::SubmissionIndex, Awaited) {
        let encoder = self.draw(|p| &p.depth, |_, _| None, |t, _| &t.occlusion, draws);
        let submission = self.device.queue.submit([encoder.finish()]);
        let done = Signal::default();
        let signal = done.clone();
        self.device.queue.on_submitted_work_done(move || signal.set(true));
        (submission, Awaited::Occluders { done })
    }

    fn shade(&mut self, draws: &[Draw], with_depth: bool) -> (wgpu::SubmissionIndex, Awaited) {
        let [r, g, b] = light::SKY.map(f64::from);
        let sky = wgpu::Color { r, g, b, a: 1.0 };
        let mut encoder = self.draw(
            |p| &p.shade,
            |targets, device| Some((targets.color(device), sky)),
            |targets, device| targets.depth(device),
            draws,
        );
        let (device, targets, size) = (&self.device, &self.targets, self.targets.size);
        let mut color = Readback::of_target(device, &mut encoder, targets.color(device), size);
        let mut depth = with_depth
            .then(|| Readback::of_target(device, &mut encoder, targets.depth(device), size));
        let submission = device.queue.submit([encoder.finish()]);
        color.start();
        depth.iter_mut().for_each(Readback::start);
        (submission, Awaited::Picture { size, color, depth })
    }

    fn items(&mut self, draws: &[Draw]) -> (wgpu::SubmissionIndex, Awaited) {
        let nothing = wgpu::Color { r: f64::from(NO_ITEM), g: 0.0, b: 0.0, a: 0.0 };
        let mut encoder = self.draw(
            |p| &p.items,
            |targets, device| Some((targets.items(device), nothing)),
            |targets, device| targets.depth(device),
            draws,
        );
        let (device, targets, size) = (&self.device, &self.targets, self.targets.size);
        let mut items = Readback::of_target(device, &mut encoder, targets.items(device), size);
        let submission = device.queue.submit([encoder.finish()]);
        items.start();
        (submission, Awaited::Items { size, items })
    }

    fn boxes(
        &mut self,
        boxes: &[BoxQuery],
        method: Cull,
    ) -> Result<Vec<(wgpu::SubmissionIndex, Awaited)>, BackendError> {
        let instances = queries::instances(boxes);
        let buffer = self.boxes.write(&self.device, bytemuck::cast_slice(&instances));
        let (device, pipelines, targets) = (&self.device, &self.pipelines, &self.targets);
        let context = Context { device, pipelines, targets };
        match method {
            Cull::Queries => {
                Ok(queries::submit_queries(&context, buffer, boxes.len(), &mut self.query_pool))
            }
            Cull::Boxes => Ok(vec![queries::submit_marks(&context, buffer, boxes.len())?]),
            Cull::Off => panic!("boxes are not tested when culling is off"),
        }
    }
}

impl Backend for WgpuBackend {
    fn info(&self) -> BackendInfo {
        let Device { name, driver, .. } = &self.device;
        BackendInfo { name: "gpu".to_owned(), driver: format!("{name}, {driver}") }
    }

    fn upload(
        &mut self,
        blob: BlobId,
        vertices: u32,
        triangles: u32,
        bytes: &[u8],
    ) -> Result<(), BackendError> {
        self.memory.upload(&self.device, blob, vertices, triangles, bytes)?;
        self.device.fault.check()
    }

    fn evict(&mut self, blob: BlobId) {
        self.memory.evict(blob);
    }

    fn submit(&mut self, pass: Pass) -> Result<Ticket, BackendError> {
        let (Pass::Occluders { view, .. }
        | Pass::QueryBoxes { view, .. }
        | Pass::Shade { view, .. }
        | Pass::Items { view, .. }) = &pass;
        self.begin(view)?;
        let submitted = match &pass {
            Pass::Occluders { draws, .. } => vec![self.occluders(draws)],
            Pass::Shade { draws, with_depth, .. } => vec![self.shade(draws, *with_depth)],
            Pass::Items { draws, .. } => vec![self.items(draws)],
            Pass::QueryBoxes { boxes, .. } if boxes.is_empty() => Vec::new(),
            Pass::QueryBoxes { boxes, method, .. } => self.boxes(boxes, *method)?,
        };
        self.device.fault.check()?;
        let ticket = Ticket(self.next_ticket);
        self.next_ticket += 1;
        if submitted.is_empty() {
            self.pending.push_back(Pending { ticket, submission: None, awaited: Awaited::NoBoxes });
        }
        for (submission, awaited) in submitted {
            self.pending.push_back(Pending { ticket, submission: Some(submission), awaited });
        }
        Ok(ticket)
    }

    fn poll(&mut self, completions: &mut Vec<Completion>) -> Result<(), BackendError> {
        let Some(first) = self.pending.front() else { return self.device.fault.check() };
        let wait = match first.submission.clone() {
            Some(submission) => {
                wgpu::PollType::Wait { submission_index: Some(submission), timeout: None }
            }
            None => wgpu::PollType::Poll,
        };
        self.device.device.poll(wait).map_err(|e| BackendError::Device(e.to_string()))?;
        self.device.fault.check()?;
        let before = completions.len();
        while let Some(pending) = self.pending.pop_front() {
            if !pending.awaited.is_ready()? {
                self.pending.push_front(pending);
                break;
            }
            completions.push(pending.complete(&mut self.query_pool)?);
        }
        // A finished submission has told its callbacks, unless the device was lost meanwhile.
        if completions.len() == before {
            return Err(BackendError::Device("a finished pass brought no result".to_owned()));
        }
        Ok(())
    }
}
