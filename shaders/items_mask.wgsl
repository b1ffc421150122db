// The id of the nearest item with holes at every pixel.

struct VertexOut {
    @invariant @builtin(position) clip: vec4<f32>,
    @location(0) @interpolate(flat) item: u32,
    @location(1) alpha: f32,
    @location(2) tex_coord: vec2<f32>,
    @location(3) @interpolate(flat) texture_index: u32,
    @location(4) @interpolate(flat) cutoff: f32,
}

@vertex
fn vertex_main(vertex: Vertex, texturing: Texturing, instance: Instance) -> VertexOut {
    return VertexOut(
        clip_position(eye_relative(vertex.position, instance)),
        instance.item,
        unpack4x8unorm(vertex.color).a,
        texturing.tex_coord,
        texturing.texture_index,
        texturing.cutoff,
    );
}

@fragment
fn fragment_main(in: VertexOut) -> @location(0) u32 {
    guard(in.clip);
    let across = dpdx(in.tex_coord);
    let down = dpdy(in.tex_coord);
    if in.alpha * sampled(in.texture_index, in.tex_coord, across, down).a < in.cutoff {
        discard;
    }
    return in.item;
}
