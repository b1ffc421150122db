// Common to the passes that shade: normals, and one sun with ambient light, both sides alike.

fn octahedral_normal(bits: u32) -> vec3<f32> {
    return from_octahedral(unpack2x16snorm(bits));
}

// Octahedral decoding (Cigolle et al. 2014, section 3.1), not normalised.
fn from_octahedral(pair: vec2<f32>) -> vec3<f32> {
    let z = 1.0 - abs(pair.x) - abs(pair.y);
    let fold = max(-z, 0.0);
    return vec3<f32>(pair + select(vec2<f32>(fold), vec2<f32>(-fold), pair >= vec2<f32>(0.0)), z);
}

// A normal under the cofactors of the linear part. The columns are brought to unit size first: a
// grid step may be so small that products of columns vanish.
fn scene_normal(normal: vec3<f32>, instance: Instance) -> vec3<f32> {
    let largest = max(max(abs(instance.column_x), abs(instance.column_y)), abs(instance.column_z));
    let scale = max(max(max(largest.x, largest.y), largest.z), 1e-37);
    let x = instance.column_x / scale;
    let y = instance.column_y / scale;
    let z = instance.column_z / scale;
    return unit(cross(y, z) * normal.x + cross(z, x) * normal.y + cross(x, y) * normal.z);
}

// Unit length, or zero for zero: a mesh may hold degenerate triangles.
fn unit(v: vec3<f32>) -> vec3<f32> {
    let squared = dot(v, v);
    return select(vec3<f32>(0.0), v * inverseSqrt(max(squared, 1e-37)), squared > 0.0);
}

// The unit normal that faces the viewer.
fn facing(interpolated_normal: vec3<f32>, position: vec3<f32>) -> vec3<f32> {
    let normal = unit(interpolated_normal);
    return select(normal, -normal, dot(normal, position) > 0.0);
}

// Light on a surface with a unit normal that faces the viewer.
fn intensity(normal: vec3<f32>, sun: vec3<f32>) -> f32 {
    return frame.ambient + frame.diffuse * max(dot(normal, sun), 0.0);
}

fn light(interpolated_normal: vec3<f32>, position: vec3<f32>) -> f32 {
    return intensity(facing(interpolated_normal, position), frame.sun);
}

// A normal as a pixel of 8 bits an axis, 0 halfway. Halves are rounded up here, for drivers differ there.
fn normal_code(normal: vec3<f32>) -> vec4<f32> {
    return vec4<f32>(floor(127.5 * normal + 128.0) / 255.0, 1.0);
}
