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

@fragment
fn fragment_mask_normal(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    if shaded(in).a < in.cutoff {
        discard;
    }
    return normal_code(facing(in.normal, in.eye_relative));
}
