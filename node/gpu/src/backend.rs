//! The backend: takes passes, hands back completions.

use crate::awaited::{Awaited, Pending};
use crate::device::{Adapter, Device};
use crate::draws;
use crate::geometry_memory::GeometryMemory;
use crate::mesh_pipelines::{Into, MeshPipelines};
use crate::pipelines::Pipelines;
use crate::queries::{self, QueryBatch};
use crate::readback::{Readback, Signal};
use crate::recorder::Recorder;
use crate::stream_buffer::StreamBuffer;
use crate::targets::{Targets, cleared_depth, read_depth};
use crate::textures::Textures;
use protocol::format::Blob;
use protocol::id::BlobId;
use protocol::settings::{Cull, PictureSize};
use protocol::telemetry::BackendInfo;
use scene::backend::{
    Backend, BackendError, BoxQuery, Completion, Draw, NO_ITEM, Pass, TextureUpload, Ticket, View,
    light,
};
use scene::occludee::Rules;
use shaders::mirror::Frame;
use std::collections::VecDeque;

/// Draws through a graphics driver.
///
/// A pass whose view has another size than the one before gets new targets, and the occlusion depth
/// starts empty: boxes are visible then, until the next occluder pass.
pub struct WgpuBackend {
    device: Device,
    pipelines: Pipelines,
    meshes: MeshPipelines,
    targets: Targets,
    memory: GeometryMemory,
    textures: Textures,
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
    /// Opens an adapter and compiles the pipelines of the box tests; those of meshes follow at need. Of
    /// the rules it follows those of the depth test and of the bias.
    ///
    /// Errors: `NoAdapter`, `Unsupported` for a size beyond the adapter's limits, `Device`.
    pub fn new(size: PictureSize, choice: Adapter, rules: &Rules) -> Result<Self, BackendError> {
        let device = Device::open(choice)?;
        let targets = Targets::new(&device, size)?;
        let pipelines = Pipelines::new(&device, rules);
        let meshes = MeshPipelines::new(&device, rules);
        let textures = Textures::new(&device);
        device.fault.check()?;
        Ok(Self {
            device,
            pipelines,
            meshes,
            targets,
            memory: GeometryMemory::default(),
            textures,
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

    /// Clears and draws, and leaves the encoder open for copies. Whether anything blends.
    fn draw(&mut self, into: Into, draws: &[Draw]) -> (wgpu::CommandEncoder, bool) {
        let Self { device, targets, memory, .. } = self;
        let plan = draws::plan(draws, |draw| memory.place(draw.blob));
        let mut encoder = device.device.create_command_encoder(&Default::default());
        let instances = (!plan.instances.is_empty())
            .then(|| self.instances.write(device, bytemuck::cast_slice(&plan.instances)));
        let mut recorder = Recorder {
            device,
            pipelines: &self.pipelines,
            memory,
            meshes: &mut self.meshes,
            textures: &mut self.textures,
            instances,
        };
        let [r, g, b] = light::SKY.map(f64::from);
        let sky = wgpu::Color { r, g, b, a: 1.0 };
        let nothing = wgpu::Color { r: f64::from(NO_ITEM), g: 0.0, b: 0.0, a: 0.0 };
        let mut calls = plan.solid(into);
        let (color, depth) = match into {
            Into::Depth => (None, &targets.occlusion),
            Into::Picture => (Some((targets.color(device), sky)), targets.depth(device)),
            Into::Items => (Some((targets.items(device), nothing)), targets.depth(device)),
        };
        let blending = plan.blending(into);
        let blends = !blending.is_empty();
        if into == Into::Picture {
            calls.extend(blending);
            recorder.pass(&mut encoder, color, cleared_depth(depth), &calls);
        } else {
            recorder.pass(&mut encoder, color, cleared_depth(depth), &calls);
            if into == Into::Items && blends {
                let color = Some((targets.blended(device), nothing));
                recorder.pass(&mut encoder, color, read_depth(depth), &blending);
            }
        }
        (encoder, blends)
    }

    fn occluders(&mut self, draws: &[Draw]) -> (wgpu::SubmissionIndex, Awaited) {
        let (encoder, _) = self.draw(Into::Depth, draws);
        let submission = self.device.queue.submit([encoder.finish()]);
        let done = Signal::default();
        let signal = done.clone();
        self.device.queue.on_submitted_work_done(move || signal.set(true));
        (submission, Awaited::Occluders { done })
    }

    fn shade(&mut self, draws: &[Draw], with_depth: bool) -> (wgpu::SubmissionIndex, Awaited) {
        let (mut encoder, _) = self.draw(Into::Picture, draws);
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
        let (mut encoder, blends) = self.draw(Into::Items, draws);
        let (device, targets, size) = (&self.device, &self.targets, self.targets.size);
        let mut items = Readback::of_target(device, &mut encoder, targets.items(device), size);
        let mut blended = blends
            .then(|| Readback::of_target(device, &mut encoder, targets.blended(device), size));
        let submission = device.queue.submit([encoder.finish()]);
        items.start();
        blended.iter_mut().for_each(Readback::start);
        (submission, Awaited::Items { size, items, blended })
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

    fn upload_textures(&mut self, textures: &[TextureUpload<'_>]) -> Result<(), BackendError> {
        self.textures.upload(&self.device, textures)?;
        self.device.fault.check()
    }

    fn upload(&mut self, id: BlobId, blob: &Blob, bytes: &[u8]) -> Result<(), BackendError> {
        self.memory.upload(&self.device, id, blob, bytes)?;
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
