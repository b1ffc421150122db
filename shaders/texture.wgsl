// Common to the passes that read textures: a trilinear filter over pixels that are already linear.
//
// It is written out rather than left to samplers: each axis of each texture wraps in its own way, small
// textures lie in the lower mips of a layer, and the filter is the processor's own to the last step.

// A vertex of a textured mesh goes on with this.
struct Texturing {
    @location(8) tex_coord: vec2<f32>,
    @location(9) texture_index: u32,
    @location(10) cutoff: f32,
}

// Where a texture lies.
struct TextureRecord {
    // Which of the arrays.
    array: u32,
    layer: u32,
    // Mip of the layer that is the texture's largest.
    first_level: u32,
    // Pixels along a side of the largest mip, a power of two.
    side: u32,
    // 0 repeat, 1 clamp, 2 mirror; across and down.
    wrap_across: u32,
    wrap_down: u32,
}

@group(1) @binding(0) var<storage, read> textures: array<TextureRecord>;
@group(1) @binding(1) var array_16: texture_2d_array<f32>;
@group(1) @binding(2) var array_32: texture_2d_array<f32>;
@group(1) @binding(3) var array_64: texture_2d_array<f32>;
@group(1) @binding(4) var array_128: texture_2d_array<f32>;
@group(1) @binding(5) var array_256: texture_2d_array<f32>;
@group(1) @binding(6) var array_512: texture_2d_array<f32>;
@group(1) @binding(7) var array_1024: texture_2d_array<f32>;

const NO_TEXTURE: u32 = 0xffffffffu;

fn pixel(record: TextureRecord, at: vec2<u32>, mip: u32) -> vec4<f32> {
    let level = record.first_level + mip;
    switch record.array {
        case 0u: { return textureLoad(array_16, at, record.layer, level); }
        case 1u: { return textureLoad(array_32, at, record.layer, level); }
        case 2u: { return textureLoad(array_64, at, record.layer, level); }
        case 3u: { return textureLoad(array_128, at, record.layer, level); }
        case 4u: { return textureLoad(array_256, at, record.layer, level); }
        case 5u: { return textureLoad(array_512, at, record.layer, level); }
        default: { return textureLoad(array_1024, at, record.layer, level); }
    }
}

// A coordinate near 0 that shows the same: whole pairs of textures taken off, or the far outside cut.
fn reduced(coordinate: f32, wrap: u32) -> f32 {
    return select(coordinate - 2.0 * floor(coordinate * 0.5), clamp(coordinate, -1.0, 2.0), wrap == 1u);
}

// The pixel of a row of `side`, a power of two, that shows at `at`.
fn wrapped(at: i32, side: i32, wrap: u32) -> u32 {
    if wrap == 1u {
        return u32(clamp(at, 0, side - 1));
    }
    if wrap == 2u {
        let folded = at & (2 * side - 1);
        return u32(min(folded, 2 * side - 1 - folded));
    }
    return u32(at & (side - 1));
}

fn bilinear(record: TextureRecord, mip: u32, tex_coord: vec2<f32>) -> vec4<f32> {
    let side = i32(record.side >> mip);
    let place = vec2<f32>(
        reduced(tex_coord.x, record.wrap_across),
        reduced(tex_coord.y, record.wrap_down),
    ) * f32(side) - 0.5;
    let below = floor(place);
    let share = place - below;
    let first = vec2<i32>(below);
    let x0 = wrapped(first.x, side, record.wrap_across);
    let x1 = wrapped(first.x + 1, side, record.wrap_across);
    let y0 = wrapped(first.y, side, record.wrap_down);
    let y1 = wrapped(first.y + 1, side, record.wrap_down);
    let upper = mix(pixel(record, vec2(x0, y0), mip), pixel(record, vec2(x1, y0), mip), share.x);
    let lower = mix(pixel(record, vec2(x0, y1), mip), pixel(record, vec2(x1, y1), mip), share.x);
    return mix(upper, lower, share.y);
}

// Linear colour and alpha; white where there is no texture. `across` and `down` are what `tex_coord`
// changes by to the next pixel (OpenGL 4.6, section 8.14).
fn sampled(index: u32, tex_coord: vec2<f32>, across: vec2<f32>, down: vec2<f32>) -> vec4<f32> {
    if index == NO_TEXTURE {
        return vec4<f32>(1.0);
    }
    let record = textures[index];
    let side = f32(record.side);
    let longest = max(dot(across, across), dot(down, down)) * (side * side);
    let last = firstLeadingBit(record.side);
    let lod = clamp(0.5 * log2(max(longest, 1.0)), 0.0, f32(last));
    let mip = u32(lod);
    let finer = bilinear(record, mip, tex_coord);
    let share = lod - f32(mip);
    if share == 0.0 {
        return finer;
    }
    return mix(finer, bilinear(record, min(mip + 1u, last), tex_coord), share);
}
