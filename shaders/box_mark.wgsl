// One draw of all boxes: every fragment that passes the depth test marks its box.

@group(0) @binding(1) var<storage, read_write> visible: array<u32>;

struct VertexOut {
    @invariant @builtin(position) clip: vec4<f32>,
    @location(0) @interpolate(flat) box_index: u32,
}

@vertex
fn mark_vertex(
    @builtin(vertex_index) vertex: u32,
    @builtin(instance_index) box_index: u32,
    bounds: BoxInstance,
) -> VertexOut {
    return VertexOut(box_clip_position(vertex, bounds), box_index);
}

// Without the early test the store would happen for hidden fragments too. Fragments of one box may race,
// but only to store the same 1.
@fragment
@early_depth_test(force)
fn mark_fragment(in: VertexOut) {
    visible[in.box_index] = 1u;
}
