// Common to the passes that test bounding boxes against the occlusion depth.

struct BoxInstance {
    @location(0) least: vec3<f32>,
    @location(1) greatest: vec3<f32>,
}

// All six faces as one strip of 14 vertices: bit i of each
// constant tells whether vertex i lies on the greatest side of that axis.
fn box_clip_position(vertex: u32, bounds: BoxInstance) -> vec4<f32> {
    let bit = 1u << vertex;
    let on_greatest_side = (vec3<u32>(0x287au, 0x02afu, 0x31e3u) & vec3<u32>(bit)) != vec3<u32>(0u);
    let corner = select(bounds.least, bounds.greatest, on_greatest_side);
    return clip_position(corner);
}
