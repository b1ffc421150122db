// Occluders: depth alone.

@vertex
fn vertex_main(vertex: Vertex, instance: Instance) -> @invariant @builtin(position) vec4<f32> {
    return clip_position(eye_relative(vertex.position, instance));
}

// For drivers that need the guard alone.
@fragment
fn fragment_guard(@builtin(position) position: vec4<f32>) {
    guard(position);
}
