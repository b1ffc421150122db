// The picture of meshes with textures.

struct VertexOut {
    @invariant @builtin(position) clip: vec4<f32>,
    @location(0) normal: vec3<f32>,
    @location(1) eye_relative: vec3<f32>,
    @location(2) color: vec4<f32>,
    @location(3) tex_coord: vec2<f32>,
    @location(4) @interpolate(flat) texture_index: u32,
    @location(5) @interpolate(flat) cutoff: f32,
}

@vertex
fn vertex_main(vertex: Vertex, texturing: Texturing, instance: Instance) -> VertexOut {
    let position = eye_relative(vertex.position, instance);
    return VertexOut(
        clip_position(position),
        scene_normal(octahedral_normal(vertex.normal), instance),
        position,
        unpack4x8unorm(vertex.color),
        texturing.tex_coord,
        texturing.texture_index,
        texturing.cutoff,
    );
}

fn shaded(in: VertexOut) -> vec4<f32> {
    let across = dpdx(in.tex_coord);
    let down = dpdy(in.tex_coord);
    let base = in.color * sampled(in.texture_index, in.tex_coord, across, down);
    return vec4<f32>(base.rgb * light(in.normal, in.eye_relative), base.a);
}

@fragment
fn fragment_main(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    return vec4<f32>(shaded(in).rgb, 1.0);
}

@fragment
fn fragment_blend(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    return shaded(in);
}

@fragment
fn fragment_normal(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    return normal_code(facing(in.normal, in.eye_relative));
}
