// The id of the nearest item at every pixel.

struct VertexOut {
    @invariant @builtin(position) clip: vec4<f32>,
    @location(0) @interpolate(flat) item: u32,
}

@vertex
fn vertex_main(vertex: Vertex, instance: Instance) -> VertexOut {
    return VertexOut(clip_position(eye_relative(vertex.position, instance)), instance.item);
}

@fragment
fn fragment_main(in: VertexOut) -> @location(0) u32 {
    guard(in.clip);
    return in.item;
}
