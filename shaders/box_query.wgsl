// Boxes as occlusion queries: the query counts, so there is no fragment stage.

@vertex
fn query_vertex(
    @builtin(vertex_index) vertex: u32,
    bounds: BoxInstance,
) -> @invariant @builtin(position) vec4<f32> {
    return box_clip_position(vertex, bounds);
}
