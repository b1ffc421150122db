// In front of the sources that draw meshes, for all other drivers.

fn guard(position: vec4<f32>) {}
