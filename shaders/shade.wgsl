// The picture of meshes without textures.

struct VertexOut {
    @invariant @builtin(position) clip: vec4<f32>,
    @location(0) normal: vec3<f32>,
    @location(1) eye_relative: vec3<f32>,
    @location(2) color: vec4<f32>,
}

@vertex
fn vertex_main(vertex: Vertex, instance: Instance) -> VertexOut {
    let position = eye_relative(vertex.position, instance);
    return VertexOut(
        clip_position(position),
        scene_normal(octahedral_normal(vertex.normal), instance),
        position,
        unpack4x8unorm(vertex.color),
    );
}

@fragment
fn fragment_main(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    return vec4<f32>(in.color.rgb * light(in.normal, in.eye_relative), 1.0);
}

@fragment
fn fragment_blend(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    return vec4<f32>(in.color.rgb * light(in.normal, in.eye_relative), in.color.a);
}

@fragment
fn fragment_normal(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    return normal_code(facing(in.normal, in.eye_relative));
}
