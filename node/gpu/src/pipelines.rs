//! The uniform all pipelines share, those of the box tests, and how one is compiled.

use crate::device::Device;
use crate::targets::DEPTH_FORMAT;
use scene::occludee::{BOX_BIAS_PX, Rules};
use shaders::mirror::{BoxInstance, Field, Frame, Kind};
use wgpu::{CompareFunction, VertexFormat};

/// The uniform, and the pipelines that test boxes.
pub(crate) struct Pipelines {
    /// The uniform [`Frame`].
    pub(crate) frame: wgpu::Buffer,
    /// [`Pipelines::frame`] alone: group 0 of all but `mark`.
    pub(crate) frame_group: wgpu::BindGroup,
    /// Its layout.
    pub(crate) frame_group_layout: wgpu::BindGroupLayout,
    /// Layout of group 0 of `mark`: the uniform, then the marks.
    pub(crate) mark_group_layout: wgpu::BindGroupLayout,
    pub(crate) query: wgpu::RenderPipeline,
    /// None where the device lacks what it needs.
    pub(crate) mark: Option<wgpu::RenderPipeline>,
}

/// What tells one pipeline from another.
pub(crate) struct Recipe<'a> {
    pub(crate) label: &'a str,
    pub(crate) source: &'a str,
    pub(crate) vertex: &'a str,
    pub(crate) fragment: Option<&'a str>,
    pub(crate) target: Option<wgpu::ColorTargetState>,
    pub(crate) groups: &'a [Option<&'a wgpu::BindGroupLayout>],
    pub(crate) buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    pub(crate) cull: Option<wgpu::Face>,
    pub(crate) front: wgpu::FrontFace,
    pub(crate) depth_write: bool,
    /// What depth is moved by, towards the eye: pixels times its steepness.
    pub(crate) bias_px: f64,
    pub(crate) compare: CompareFunction,
}

impl Pipelines {
    /// Compiles them.
    pub(crate) fn new(device: &Device, rules: &Rules) -> Self {
        let gpu = &device.device;
        let uniform =
            entry(0, wgpu::ShaderStages::VERTEX_FRAGMENT, wgpu::BufferBindingType::Uniform);
        let marks = entry(
            1,
            wgpu::ShaderStages::FRAGMENT,
            wgpu::BufferBindingType::Storage { read_only: false },
        );
        let group_layout = |entries: &[wgpu::BindGroupLayoutEntry]| {
            gpu.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries })
        };
        let (frame_group_layout, mark_group_layout) =
            (group_layout(&[uniform]), group_layout(&[uniform, marks]));
        let frame = gpu.create_buffer(&wgpu::BufferDescriptor {
            label: Some("frame"),
            size: size_of::<Frame>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let frame_group = gpu.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &frame_group_layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() }],
        });
        let bounds = attributes(BoxInstance::FIRST_LOCATION, BoxInstance::FIELDS, 0);
        let box_buffers = [Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<BoxInstance>() as u64,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &bounds,
        })];
        let (frame_group_only, mark_group) =
            ([Some(&frame_group_layout)], [Some(&mark_group_layout)]);
        let query = Recipe {
            label: "box queries",
            source: shaders::BOX_QUERY,
            vertex: "query_vertex",
            fragment: None,
            target: None,
            groups: &frame_group_only,
            buffers: &box_buffers,
            cull: None,
            front: wgpu::FrontFace::Ccw,
            depth_write: false,
            bias_px: if rules.bias { BOX_BIAS_PX } else { 0.0 },
            compare: if rules.depth_test_inclusive {
                CompareFunction::GreaterEqual
            } else {
                CompareFunction::Greater
            },
        };
        Self {
            query: compile(gpu, &query),
            mark: device.can_mark_boxes.then(|| {
                compile(
                    gpu,
                    &Recipe {
                        label: "box marks",
                        source: shaders::BOX_MARK,
                        vertex: "mark_vertex",
                        fragment: Some("mark_fragment"),
                        groups: &mark_group,
                        ..query
                    },
                )
            }),
            frame,
            frame_group,
            frame_group_layout,
            mark_group_layout,
        }
    }
}

pub(crate) fn compile(device: &wgpu::Device, recipe: &Recipe<'_>) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(recipe.label),
        source: wgpu::ShaderSource::Wgsl(recipe.source.into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(recipe.label),
        bind_group_layouts: recipe.groups,
        immediate_size: 0,
    });
    let targets: Vec<_> = recipe.target.iter().cloned().map(Some).collect();
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(recipe.label),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some(recipe.vertex),
            compilation_options: Default::default(),
            buffers: recipe.buffers,
        },
        primitive: wgpu::PrimitiveState {
            cull_mode: recipe.cull,
            front_face: recipe.front,
            ..Default::default()
        },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(recipe.depth_write),
            depth_compare: Some(recipe.compare),
            stencil: Default::default(),
            bias: wgpu::DepthBiasState { slope_scale: recipe.bias_px as f32, ..Default::default() },
        }),
        multisample: Default::default(),
        fragment: recipe.fragment.map(|entry_point| wgpu::FragmentState {
            module: &module,
            entry_point: Some(entry_point),
            compilation_options: Default::default(),
            targets: &targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}

pub(crate) fn entry(
    binding: u32,
    visibility: wgpu::ShaderStages,
    ty: wgpu::BufferBindingType,
) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}

/// Attributes of a buffer in which the fields begin at `start`.
pub(crate) fn attributes(
    first_location: u32,
    fields: &[Field],
    start: u64,
) -> Vec<wgpu::VertexAttribute> {
    let attribute = |(field, shader_location): (&Field, u32)| wgpu::VertexAttribute {
        format: match field.kind {
            Kind::Uint32 => VertexFormat::Uint32,
            Kind::Uint32x2 => VertexFormat::Uint32x2,
            Kind::Float32 => VertexFormat::Float32,
            Kind::Float32x2 => VertexFormat::Float32x2,
            Kind::Float32x3 => VertexFormat::Float32x3,
            Kind::Matrix4 => unreachable!("no vertex carries a matrix"),
        },
        offset: start + field.offset as u64,
        shader_location,
    };
    fields.iter().zip(first_location..).map(attribute).collect()
}
