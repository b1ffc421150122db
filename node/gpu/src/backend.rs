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
use crate::staging::Staging;
use crate::stream_buffer::StreamBuffer;
use crate::targets::{NOTHING_IN_FRONT, Targets, read_depth, written_depth};
use crate::textures::{Arranged, Textures};
use protocol::format::{Blob, Texture};
use protocol::id::BlobId;
use protocol::settings::{Cull, PictureSize};
use protocol::telemetry::BackendInfo;
use scene::backend::{
    Backend, BackendError, BoxQuery, Completion, Draw, NO_ITEM, Pass, Shading, Ticket, UNLIMITED,
    UnderWay, Upload, View, light, normal,
};
use scene::occludee::{Precision, Rules};
use shaders::mirror::Frame;
use std::collections::VecDeque;

/// Mesa's software driver clips at twice the picture.
const SOFTWARE_GUARD_BAND: f64 = 2.0;
/// Hardware clips no farther from the middle of the picture than this, pixels.
const HARDWARE_GUARD_PX: f64 = 32768.0;

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
    /// Most bytes of both.
    budget: u64,
    staging: Staging,
    instances: StreamBuffer,
    boxes: StreamBuffer,
    query_pool: Vec<QueryBatch>,
    under_way: UnderWay,
    /// Something blends in the pass under way.
    blends: bool,
    pending: VecDeque<Pending>,
    next_ticket: u64,
}

/// Work that was submitted, and what it brings.
type Submitted = (wgpu::SubmissionIndex, Awaited);

/// What recording a pass needs to read.
pub(crate) struct Context<'a> {
    pub(crate) device: &'a Device,
    pub(crate) pipelines: &'a Pipelines,
    pub(crate) targets: &'a Targets,
}

impl WgpuBackend {
    /// Opens an adapter and compiles the pipelines of the box tests; those of meshes follow at need. Of
    /// the rules it follows those of the depth test, the bias and the guard.
    ///
    /// `budget_bytes` is the most that meshes and textures take ([`Backend::held_bytes`]). On top come
    /// targets, what is read back, the instances of a part of a pass, and uploads on their way: an eighth
    /// of the budget, 64 KiB to 32 MiB, and the mips of one texture.
    ///
    /// Errors: `NoAdapter`, `Unsupported` for a size beyond the adapter's limits, `Device`.
    pub fn new(
        size: PictureSize,
        choice: Adapter,
        rules: &Rules,
        budget_bytes: u64,
    ) -> Result<Self, BackendError> {
        let device = Device::open(choice, budget_bytes != UNLIMITED)?;
        let targets = Targets::new(&device, size)?;
        let pipelines = Pipelines::new(&device, rules);
        let meshes = MeshPipelines::new(&device, rules);
        let memory = GeometryMemory::new(&device);
        let textures = Textures::new(&device);
        device.fault.check()?;
        Ok(Self {
            device,
            pipelines,
            meshes,
            targets,
            memory,
            textures,
            budget: budget_bytes,
            staging: Staging::new(budget_bytes),
            instances: StreamBuffer::default(),
            boxes: StreamBuffer::default(),
            query_pool: Vec::new(),
            under_way: UnderWay::default(),
            blends: false,
            pending: VecDeque::new(),
            next_ticket: 0,
        })
    }

    /// Brings targets and uniform to a view and a sun.
    fn begin(&mut self, view: &View, sun: [f32; 3]) -> Result<(), BackendError> {
        if view.size != self.targets.size {
            self.targets = Targets::new(&self.device, view.size)?;
        }
        let frame = Frame {
            clip_from_eye: view.clip_from_eye,
            sun,
            ambient: light::AMBIENT,
            baked_sun: light::baked_sun(),
            diffuse: light::SUN,
        };
        self.device.queue.write_buffer(&self.pipelines.frame, 0, bytemuck::bytes_of(&frame));
        Ok(())
    }

    /// Draws a part of a pass, and leaves the encoder open for copies. What `opens` clears what it draws into.
    fn draw(
        &mut self,
        into: Into,
        [solid, blending]: [&[Draw]; 2],
        opens: bool,
    ) -> wgpu::CommandEncoder {
        let Self { device, targets, memory, .. } = self;
        let plan = draws::plan(solid, blending, |draw| memory.place(draw.blob));
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
        let opaque = |[r, g, b]: [f32; 3]| wgpu::Color {
            r: f64::from(r),
            g: f64::from(g),
            b: f64::from(b),
            a: 1.0,
        };
        let sky = opaque(light::SKY);
        let no_normal = opaque(normal::encode([0.0; 3]).map(|code| f32::from(code) / 255.0));
        let nothing = wgpu::Color { r: f64::from(NO_ITEM), g: 0.0, b: 0.0, a: 0.0 };
        let started = |opens, clear| match opens {
            true => wgpu::LoadOp::Clear(clear),
            false => wgpu::LoadOp::Load,
        };
        let mut calls = plan.solid(into);
        let (color, depth) = match into {
            Into::Depth | Into::Count => (None, &targets.occlusion),
            Into::Picture | Into::Relit => {
                (Some((targets.color(device), started(opens, sky))), targets.depth(device))
            }
            Into::Normals => {
                let cleared = started(opens, no_normal);
                (Some((targets.normals(device), cleared)), targets.depth(device))
            }
            Into::Items => {
                (Some((targets.items(device), started(opens, nothing))), targets.depth(device))
            }
        };
        let load = if opens { NOTHING_IN_FRONT } else { wgpu::LoadOp::Load };
        let blending = plan.blending(into);
        let blended_before = self.blends && !opens;
        self.blends = blended_before || !blending.is_empty();
        if matches!(into, Into::Picture | Into::Relit) {
            calls.extend(blending);
            recorder.pass(&mut encoder, color, written_depth(depth, load), &calls);
        } else {
            recorder.pass(&mut encoder, color, written_depth(depth, load), &calls);
            if into == Into::Items && !blending.is_empty() {
                let color = (targets.blended(device), started(!blended_before, nothing));
                recorder.pass(&mut encoder, Some(color), read_depth(depth), &blending);
            }
        }
        encoder
    }

    fn occluders(&mut self, encoder: wgpu::CommandEncoder) -> Submitted {
        let submission = self.device.queue.submit([encoder.finish()]);
        let done = Signal::default();
        let signal = done.clone();
        self.device.queue.on_submitted_work_done(move || signal.set(true));
        (submission, Awaited::Occluders { done })
    }

    fn picture(
        &mut self,
        mut encoder: wgpu::CommandEncoder,
        shading: Shading,
        with_depth: bool,
    ) -> Submitted {
        let (device, targets, size) = (&self.device, &self.targets, self.targets.size);
        let target = match shading {
            Shading::Lit { .. } => targets.color(device),
            Shading::Normals => targets.normals(device),
        };
        let mut color = Readback::of_target(device, &mut encoder, target, size);
        let mut depth = with_depth
            .then(|| Readback::of_target(device, &mut encoder, targets.depth(device), size));
        let submission = device.queue.submit([encoder.finish()]);
        color.start();
        depth.iter_mut().for_each(Readback::start);
        (submission, Awaited::Picture { size, color, depth })
    }

    fn items(&mut self, mut encoder: wgpu::CommandEncoder) -> Submitted {
        let (device, targets, size) = (&self.device, &self.targets, self.targets.size);
        let mut items = Readback::of_target(device, &mut encoder, targets.items(device), size);
        let mut blended = self
            .blends
            .then(|| Readback::of_target(device, &mut encoder, targets.blended(device), size));
        let submission = device.queue.submit([encoder.finish()]);
        items.start();
        blended.iter_mut().for_each(Readback::start);
        (submission, Awaited::Items { size, items, blended })
    }

    /// Draws, and says what is awaited if the part closes its pass.
    fn drawn(&mut self, pass: &Pass) -> Option<Submitted> {
        let mut keeps = false;
        let (into, lists, part) = match pass {
            Pass::Occluders { draws, adds, part, .. } => {
                keeps = *adds;
                (Into::Depth, [&draws[..], &[]], *part)
            }
            Pass::Shade { shading: Shading::Lit { sun }, draws, part, .. } => {
                let into = if *sun == light::baked_sun() { Into::Picture } else { Into::Relit };
                (into, [&draws.solid[..], &draws.blending], *part)
            }
            Pass::Shade { shading: Shading::Normals, draws, part, .. } => {
                (Into::Normals, [&draws.solid[..], &[]], *part)
            }
            Pass::Items { draws, part, .. } => {
                (Into::Items, [&draws.solid[..], &draws.blending], *part)
            }
            Pass::QueryBoxes { .. } | Pass::QueryMeshes { .. } => {
                unreachable!("what is tested is not drawn")
            }
        };
        let encoder = self.draw(into, lists, part.opens && !keeps);
        if !part.closes {
            self.device.queue.submit([encoder.finish()]);
            return None;
        }
        Some(match pass {
            Pass::Shade { shading, with_depth, .. } => self.picture(encoder, *shading, *with_depth),
            Pass::Items { .. } => self.items(encoder),
            _ => self.occluders(encoder),
        })
    }

    /// Counts what passes of each item.
    fn items_that_pass(&mut self, draws: &[Draw]) -> Vec<Submitted> {
        let Self { device, targets, memory, .. } = self;
        let plan = draws::plan(&[], draws, |draw| memory.place(draw.blob));
        let instances = self.instances.write(device, bytemuck::cast_slice(&plan.instances));
        let mut recorder = Recorder {
            device,
            pipelines: &self.pipelines,
            memory,
            meshes: &mut self.meshes,
            textures: &mut self.textures,
            instances: Some(instances),
        };
        let items = plan.by_item();
        let pipelines: Vec<_> = items.iter().map(|calls| recorder.pipelines_of(calls)).collect();
        let context = Context { device, pipelines: &self.pipelines, targets };
        let prepare = |pass: &mut wgpu::RenderPass<'_>| {
            pass.set_bind_group(0, &context.pipelines.frame_group, &[]);
            pass.set_vertex_buffer(1, instances.slice(..));
        };
        queries::submit(&context, items.len(), &mut self.query_pool, prepare, |pass, item| {
            draws::record(pass, memory, None, pipelines[item].iter().zip(&items[item]));
        })
    }

    fn boxes(&mut self, boxes: &[BoxQuery], method: Cull) -> Result<Vec<Submitted>, BackendError> {
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

    fn precision(&self) -> Precision {
        let PictureSize { width, height } = self.targets.size;
        Precision::f32(match self.device.is_software {
            true => SOFTWARE_GUARD_BAND,
            false => HARDWARE_GUARD_PX / (f64::from(width.min(height)) * 0.5),
        })
    }

    fn held_bytes(&self) -> u64 {
        self.memory.held_bytes() + self.textures.held_bytes()
    }

    fn declare_textures(
        &mut self,
        textures: &[Texture],
        room: u64,
    ) -> Result<Upload, BackendError> {
        let arranged = Arranged::new(&self.device, textures, room)?;
        let left = |held| self.budget.saturating_sub(held);
        if left(self.memory.used_bytes()) < arranged.bytes() {
            return Ok(Upload::Full);
        }
        if left(self.memory.held_bytes()) < arranged.bytes() {
            self.memory.release_unused(&self.device)?;
        }
        self.textures.declare(&self.device, textures, arranged)?;
        self.device.fault.check()?;
        Ok(Upload::Done)
    }

    fn upload_texture(&mut self, index: u32, bytes: &[u8]) -> Result<Upload, BackendError> {
        let upload = self.textures.upload(&self.device, &mut self.staging, index, bytes)?;
        self.device.fault.check()?;
        Ok(upload)
    }

    fn evict_texture(&mut self, index: u32) {
        self.textures.evict(index);
    }

    fn settle(&mut self) -> Result<(), BackendError> {
        // Writes go with the next submission.
        self.device.queue.submit([]);
        self.device.wait_for(None)?;
        self.device.fault.check()
    }

    fn upload(&mut self, id: BlobId, blob: &Blob, bytes: &[u8]) -> Result<Upload, BackendError> {
        let room = self.budget.saturating_sub(self.textures.held_bytes());
        let mesh = (id, blob, bytes);
        let upload = self.memory.upload(&self.device, &mut self.staging, room, mesh)?;
        self.device.fault.check()?;
        Ok(upload)
    }

    fn evict(&mut self, blob: BlobId) {
        self.memory.evict(blob);
    }

    fn submit(&mut self, pass: Pass) -> Result<Ticket, BackendError> {
        let (Pass::Occluders { view, .. }
        | Pass::QueryBoxes { view, .. }
        | Pass::QueryMeshes { view, .. }
        | Pass::Shade { view, .. }
        | Pass::Items { view, .. }) = &pass;
        self.under_way.take(&pass);
        // Nothing else looks at it.
        let sun = match &pass {
            Pass::Shade { shading: Shading::Lit { sun }, .. } => *sun,
            _ => [0.0; 3],
        };
        self.begin(view, sun)?;
        let tests_nothing = match &pass {
            Pass::QueryBoxes { boxes, .. } => boxes.is_empty(),
            Pass::QueryMeshes { draws, .. } => draws.is_empty(),
            _ => false,
        };
        let submitted = match &pass {
            _ if tests_nothing => Vec::new(),
            Pass::QueryMeshes { draws, .. } => self.items_that_pass(draws),
            Pass::QueryBoxes { boxes, method, .. } => self.boxes(boxes, *method)?,
            _ => self.drawn(&pass).into_iter().collect(),
        };
        self.device.fault.check()?;
        let ticket = Ticket(self.next_ticket);
        self.next_ticket += 1;
        if tests_nothing {
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
