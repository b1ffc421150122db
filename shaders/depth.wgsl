// Occluders: depth alone, no fragment stage.

@vertex
fn vertex_main(vertex: Vertex, instance: Instance) -> @invariant @builtin(position) vec4<f32> {
    return clip_position(eye_relative(vertex.position, instance));
}
