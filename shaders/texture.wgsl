// Common to the passes that read textures: a trilinear filter over pixels that are already linear.
//
// It is written out rather than left to samplers: each axis of each texture wraps in its own way, textures
// lie side by side on pages, and the filter is the processor's own to the last step. There is one array of
// pages, for a choice between several would cost drivers without branches a read of each.

// A vertex of a textured mesh goes on with this.
struct Texturing {
    @location(12) tex_coord: vec2<f32>,
    @location(13) texture_index: u32,
    @location(14) cutoff: f32,
}

// A texture.
struct TextureRecord {
    // Index into `places` of its largest mip; the others follow.
    first_place: u32,
    // Pixels along a side of the largest mip, a power of two.
    side: u32,
    // 0 repeat, 1 clamp, 2 mirror; across and down.
    wrap_across: u32,
    wrap_down: u32,
}

@group(1) @binding(0) var<storage, read> textures: array<TextureRecord>;
// Where mips lie: column and row on their page, 10 bits each, then the page.
@group(1) @binding(1) var<storage, read> places: array<u32>;
@group(1) @binding(2) var pages: texture_2d_array<f32>;

const NO_TEXTURE: u32 = 0xffffffffu;

fn pixel(place: u32, at: vec2<u32>) -> vec4<f32> {
    let corner = vec2<u32>(place & 0x3ffu, (place >> 10u) & 0x3ffu);
    return textureLoad(pages, corner + at, place >> 20u, 0);
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
    let at = places[record.first_place + mip];
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
    let upper = mix(pixel(at, vec2(x0, y0)), pixel(at, vec2(x1, y0)), share.x);
    let lower = mix(pixel(at, vec2(x0, y1)), pixel(at, vec2(x1, y1)), share.x);
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
