// The picture of meshes with holes. A module of its own, so that the others keep their early depth test.

@fragment
fn fragment_mask(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    let color = shaded(in);
    if color.a < in.cutoff {
        discard;
    }
    return vec4<f32>(color.rgb, 1.0);
}
