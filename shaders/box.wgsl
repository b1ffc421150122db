// Common to the passes that test bounding boxes against the occlusion depth.

struct BoxInstance {
    @location(0) least: vec3<f32>,
    @location(1) greatest: vec3<f32>,
}

// The faces turned to the eye, at most one an axis, two triangles each. The eye is outside the box, so
// they cover its whole outline, nearest first; the faces behind them could only fail the same test.
// Corners are the box's own numbers, so faces that meet share their edge's bits.
fn box_clip_position(vertex: u32, bounds: BoxInstance) -> vec4<f32> {
    let axis = vertex / 6u;
    let near_side = select(bounds.greatest[axis], bounds.least[axis], bounds.least[axis] > 0.0);
    if bounds.least[axis] <= 0.0 && bounds.greatest[axis] >= 0.0 {
        // Not turned to the eye: all six vertices in one point, before the near plane.
        return vec4<f32>(0.0, 0.0, -1.0, 1.0);
    }
    // Bit i of each constant: the side of corner i along the two other axes.
    let bit = 1u << (vertex % 6u);
    var corner = bounds.least;
    corner[axis] = near_side;
    let u = (axis + 1u) % 3u;
    let v = (axis + 2u) % 3u;
    corner[u] = select(bounds.least[u], bounds.greatest[u], (0x16u & bit) != 0u);
    corner[v] = select(bounds.least[v], bounds.greatest[v], (0x34u & bit) != 0u);
    return clip_position(corner);
}
