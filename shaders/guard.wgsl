// In front of the sources that draw meshes, for drivers that may make undefined depth.

// Drops a fragment whose depth is no number or lies well outside of 0 to 1. Such drivers divide by the area
// of the triangle before its corners are snapped to the pixel raster, which may be 0 where the area after
// it is not, and then bring what is no number to 1, the nearest depth there is. The bits are compared, for
// compilers may take floats to be numbers.
fn guard(position: vec4<f32>) {
    if (bitcast<u32>(position.z) & 0x7fffffffu) > 0x3f801000u {
        discard;
    }
}
