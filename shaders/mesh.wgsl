// Common to the passes that draw meshes.

// A mesh vertex as it lies in a geometry page.
struct Vertex {
    @location(0) position: vec2<u32>,
    @location(1) normal: u32,
    @location(2) color: u32,
}

// One draw of a mesh: eye_relative = column_x * x + column_y * y + column_z * z + offset.
struct Instance {
    @location(3) column_x: vec3<f32>,
    @location(4) column_y: vec3<f32>,
    @location(5) column_z: vec3<f32>,
    @location(6) offset: vec3<f32>,
    @location(7) item: u32,
    // Of projected blobs alone: what a unit of z adds to the disparity, and the picture, its first word in
    // the buffer, its side in pixels and the first word of its normals, 0 where it has none.
    @location(8) disparity_step: f32,
    @location(9) picture: u32,
    @location(10) side: u32,
    @location(11) normals: u32,
}

// Three 21-bit integers out of 63 bits; exact in f32.
fn grid_position(bits: vec2<u32>) -> vec3<f32> {
    let x = bits.x & 0x1fffffu;
    let y = (bits.x >> 21u) | ((bits.y & 0x3ffu) << 11u);
    let z = (bits.y >> 10u) & 0x1fffffu;
    return vec3<f32>(f32(x), f32(y), f32(z));
}

fn eye_relative(position: vec2<u32>, instance: Instance) -> vec3<f32> {
    let grid = grid_position(position);
    return instance.column_x * grid.x + instance.column_y * grid.y + instance.column_z * grid.z
        + instance.offset;
}
