// Common to every pass; the crate puts it in front of each. One expression takes a point to the screen,
// so that depth made in one pass holds in all of them.

struct Frame {
    clip_from_eye: mat4x4<f32>,
    sun: vec3<f32>,
    ambient: f32,
    // The sun that pictures of scan cubes show.
    baked_sun: vec3<f32>,
    diffuse: f32,
}

@group(0) @binding(0) var<uniform> frame: Frame;

fn clip_position(eye_relative: vec3<f32>) -> vec4<f32> {
    return frame.clip_from_eye * vec4<f32>(eye_relative, 1.0);
}
