//! Pipelines, one a primitive, and the uniform they share.

use crate::device::Device;
use crate::targets::{COLOR_FORMAT, DEPTH_FORMAT, ITEMS_FORMAT};
use shaders::mirror::{BoxInstance, Field, Frame, Instance, Kind, Vertex};
use wgpu::{CompareFunction, TextureFormat, VertexFormat};

/// Everything that does not change after the start.
pub(crate) struct Pipelines {
    /// The uniform [`Frame`].
    pub(crate) frame: wgpu::Buffer,
    /// [`Pipelines::frame`] alone: group 0 of all but `mark`.
    pub(crate) frame_group: wgpu::BindGroup,
    /// Layout of group 0 of `mark`: the uniform, then the marks.
    pub(crate) mark_group_layout: wgpu::BindGroupLayout,
    pub(crate) depth: wgpu::RenderPipeline,
    pub(crate) shade: wgpu::RenderPipeline,
    pub(crate) items: wgpu::RenderPipeline,
    pub(crate) query: wgpu::RenderPipeline,
    /// None where the device lacks what it needs.
    pub(crate) mark: Option<wgpu::RenderPipeline>,
}

/// What tells one pipeline from another.
struct Recipe<'a> {
    label: &'a str,
    source: &'a str,
    vertex: &'a str,
    fragment: Option<&'a str>,
    target: Option<TextureFormat>,
    group: &'a wgpu::BindGroupLayout,
    buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    depth_write: bool,
    compare: CompareFunction,
}

impl Pipelines {
    /// Compiles all of them. `inclusive_depth_test` is the rule of the box tests: boxes at the very depth
    /// of an occluder pass.
    pub(crate) fn new(device: &Device, inclusive_depth_test: bool) -> Self {
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
        let (frame_layout, mark_group_layout) =
            (group_layout(&[uniform]), group_layout(&[uniform, marks]));
        let frame = gpu.create_buffer(&wgpu::BufferDescriptor {
            label: Some("frame"),
            size: size_of::<Frame>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let frame_group = gpu.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &frame_layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() }],
        });

        let vertex = attributes(Vertex::FIRST_LOCATION, Vertex::FIELDS);
        let instance = attributes(Instance::FIRST_LOCATION, Instance::FIELDS);
        let bounds = attributes(BoxInstance::FIRST_LOCATION, BoxInstance::FIELDS);
        let mesh_buffers = [
            Some(layout::<Vertex>(wgpu::VertexStepMode::Vertex, &vertex)),
            Some(layout::<Instance>(wgpu::VertexStepMode::Instance, &instance)),
        ];
        let box_buffers = [Some(layout::<BoxInstance>(wgpu::VertexStepMode::Instance, &bounds))];
        let mesh = Recipe {
            label: "occluders",
            source: shaders::DEPTH,
            vertex: "vertex_main",
            fragment: None,
            target: None,
            group: &frame_layout,
            buffers: &mesh_buffers,
            depth_write: true,
            compare: CompareFunction::GreaterEqual,
        };
        let query = Recipe {
            label: "box queries",
            source: shaders::BOX_QUERY,
            vertex: "query_vertex",
            buffers: &box_buffers,
            depth_write: false,
            compare: if inclusive_depth_test {
                CompareFunction::GreaterEqual
            } else {
                CompareFunction::Greater
            },
            ..mesh
        };
        let fragment = Some("fragment_main");
        Self {
            depth: compile(gpu, &mesh),
            shade: compile(
                gpu,
                &Recipe {
                    label: "shade",
                    source: shaders::SHADE,
                    fragment,
                    target: Some(COLOR_FORMAT),
                    ..mesh
                },
            ),
            items: compile(
                gpu,
                &Recipe {
                    label: "items",
                    source: shaders::ITEMS,
                    fragment,
                    target: Some(ITEMS_FORMAT),
                    ..mesh
                },
            ),
            query: compile(gpu, &query),
            mark: device.can_mark_boxes.then(|| {
                compile(
                    gpu,
                    &Recipe {
                        label: "box marks",
                        source: shaders::BOX_MARK,
                        vertex: "mark_vertex",
                        fragment: Some("mark_fragment"),
                        group: &mark_group_layout,
                        ..query
                    },
                )
            }),
            frame,
            frame_group,
            mark_group_layout,
        }
    }
}

fn compile(device: &wgpu::Device, recipe: &Recipe<'_>) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(recipe.label),
        source: wgpu::ShaderSource::Wgsl(recipe.source.into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(recipe.label),
        bind_group_layouts: &[Some(recipe.group)],
        immediate_size: 0,
    });
    let targets: Vec<_> = recipe
        .target
        .into_iter()
        .map(|format| Some(wgpu::ColorTargetState::from(format)))
        .collect();
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(recipe.label),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some(recipe.vertex),
            compilation_options: Default::default(),
            buffers: recipe.buffers,
        },
        // No face is culled: scanned and imported meshes wind either way.
        primitive: wgpu::PrimitiveState { cull_mode: None, ..Default::default() },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(recipe.depth_write),
            depth_compare: Some(recipe.compare),
            stencil: Default::default(),
            bias: Default::default(),
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

fn entry(
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

fn layout<T>(
    step_mode: wgpu::VertexStepMode,
    attributes: &[wgpu::VertexAttribute],
) -> wgpu::VertexBufferLayout<'_> {
    wgpu::VertexBufferLayout { array_stride: size_of::<T>() as u64, step_mode, attributes }
}

fn attributes(first_location: u32, fields: &[Field]) -> Vec<wgpu::VertexAttribute> {
    let attribute = |(field, shader_location): (&Field, u32)| wgpu::VertexAttribute {
        format: match field.kind {
            Kind::Uint32 => VertexFormat::Uint32,
            Kind::Uint32x2 => VertexFormat::Uint32x2,
            Kind::Float32 => VertexFormat::Float32,
            Kind::Float32x3 => VertexFormat::Float32x3,
            Kind::Matrix4 => unreachable!("no vertex carries a matrix"),
        },
        offset: field.offset as u64,
        shader_location,
    };
    fields.iter().zip(first_location..).map(attribute).collect()
}
