// Faces of scan cubes: meshes whose blob holds their own picture, which is shaded. Vertices are a place in
// the picture, in 1/16 pixels, and a disparity. The sampled colour is the processor's own to the last step.

// The buffer the blob lies in. The picture: a word for each 16x16 pixels, row by row, 0 or 1 + the place of
// its tile; then tiles of 4x4 BC1 blocks, two words each.
@group(1) @binding(0) var<storage, read> words: array<u32>;

struct VertexOut {
    @invariant @builtin(position) clip: vec4<f32>,
    // In the picture, pixels.
    @location(0) place: vec2<f32>,
    @location(1) @interpolate(flat) item: u32,
    @location(2) @interpolate(flat) picture: u32,
    @location(3) @interpolate(flat) side: u32,
}

// What `eye_relative` gives is the position times the disparity, which therefore is its fourth
// homogeneous coordinate.
@vertex
fn vertex_main(@location(0) position: vec2<u32>, instance: Instance) -> VertexOut {
    let grid = grid_position(position);
    let disparity = grid.z * instance.disparity_step;
    let clip = frame.clip_from_eye * vec4<f32>(eye_relative(position, instance), disparity);
    return VertexOut(clip, grid.xy / 16.0, instance.item, instance.picture, instance.side);
}

// Both ends of a BC1 block are 5, 6 and 5 bits, widened by repeating the high ones.
fn block_end(bits: u32) -> vec3<u32> {
    let five = vec3<u32>(bits >> 11u, bits >> 5u, bits) & vec3<u32>(31u, 63u, 31u);
    return (five << vec3<u32>(3u, 2u, 3u)) | (five >> vec3<u32>(2u, 4u, 2u));
}

fn linear(code: vec3<u32>) -> vec3<f32> {
    let s = vec3<f32>(code) / 255.0;
    return select(pow((s + 0.055) / 1.055, vec3<f32>(2.4)), s / 12.92, s <= vec3<f32>(0.04045));
}

// Linear colour of a pixel and 1; all zero where its tile is not stored.
fn pixel(picture: u32, side: u32, at: vec2<u32>) -> vec4<f32> {
    let across = side / 16u;
    let entry = words[picture + at.y / 16u * across + at.x / 16u];
    if entry == 0u {
        return vec4<f32>(0.0);
    }
    let tile = picture + across * across + (entry - 1u) * 32u;
    let block = tile + ((at.y % 16u / 4u) * 4u + at.x % 16u / 4u) * 2u;
    let ends = words[block];
    let selector = (words[block + 1u] >> (2u * (4u * (at.y % 4u) + at.x % 4u))) & 3u;
    // Thirds of the first end by selector: 3, 0, 2, 1.
    let thirds = (0x63u >> (2u * selector)) & 3u;
    let code = (thirds * block_end(ends & 0xffffu) + (3u - thirds) * block_end(ends >> 16u)) / 3u;
    return vec4<f32>(linear(code), 1.0);
}

// Bilinear. What is not stored shows the nearest of the four pixels that is; black where none is.
fn sampled(picture: u32, side: u32, place: vec2<f32>) -> vec3<f32> {
    let from_center = clamp(place, vec2<f32>(0.0), vec2<f32>(f32(side))) - 0.5;
    let below = floor(from_center);
    let share = from_center - below;
    let last = vec2<i32>(i32(side) - 1);
    var sum = vec4<f32>(0.0);
    var nearest = vec3<f32>(0.0);
    var most = -1.0;
    for (var corner = 0u; corner < 4u; corner++) {
        let step = vec2<u32>(corner & 1u, corner >> 1u);
        let at = vec2<u32>(clamp(vec2<i32>(below) + vec2<i32>(step), vec2<i32>(0), last));
        let shares = select(1.0 - share, share, step == vec2<u32>(1u));
        let weight = shares.x * shares.y;
        let color = pixel(picture, side, at);
        if color.a > 0.0 && weight > most {
            nearest = color.rgb;
            most = weight;
        }
        sum += color * weight;
    }
    return sum.rgb + nearest * (1.0 - sum.a);
}

@fragment
fn fragment_main(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    return vec4<f32>(sampled(in.picture, in.side, in.place), 1.0);
}

// A picture has all its light.
@fragment
fn fragment_normal(in: VertexOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    return normal_code(vec3<f32>(0.0));
}

@fragment
fn fragment_items(in: VertexOut) -> @location(0) u32 {
    guard(in.clip);
    return in.item;
}

// For drivers that need the guard alone.
@fragment
fn fragment_guard(@builtin(position) position: vec4<f32>) {
    guard(position);
}
