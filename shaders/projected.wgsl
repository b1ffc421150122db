// Faces of scan cubes: meshes whose blob holds their own picture, which is shaded. Vertices are a place in
// the picture, in 1/16 pixels, and a disparity. The sampled colour is the processor's own to the last step.
// Under another sun than the picture's, what has normals is lit again.

// The buffer the blob lies in. The picture: a word for each 16x16 pixels, row by row, 0 or 1 + the place of
// its tile; then tiles of 4x4 BC1 blocks, two words each. Normals are as many tiles, elsewhere.
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
    let place = grid_position(position).xy / 16.0;
    return VertexOut(clip_of(position, instance), place, instance.item, instance.picture, instance.side);
}

fn clip_of(position: vec2<u32>, instance: Instance) -> vec4<f32> {
    let disparity = grid_position(position).z * instance.disparity_step;
    return frame.clip_from_eye * vec4<f32>(eye_relative(position, instance), disparity);
}

struct RelitOut {
    @invariant @builtin(position) clip: vec4<f32>,
    // In the picture, pixels.
    @location(0) place: vec2<f32>,
    @location(1) @interpolate(flat) picture: u32,
    @location(2) @interpolate(flat) side: u32,
    @location(3) @interpolate(flat) normals: u32,
    // In the axes of the normals.
    @location(4) @interpolate(flat) sun: vec3<f32>,
    @location(5) @interpolate(flat) baked_sun: vec3<f32>,
}

// Normals have the face's axes: right, up, and back to the viewpoint.
@vertex
fn vertex_relit(@location(0) position: vec2<u32>, instance: Instance) -> RelitOut {
    let right = unit(instance.column_x);
    let down = unit(instance.column_y);
    let face = transpose(mat3x3<f32>(right, -down, cross(down, right)));
    return RelitOut(
        clip_of(position, instance),
        grid_position(position).xy / 16.0,
        instance.picture,
        instance.side,
        instance.normals,
        face * frame.sun,
        face * frame.baked_sun,
    );
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

// A picture, and how it is lit again, in the axes of its normals.
struct Shown {
    picture: u32,
    side: u32,
    // 0 where its light stays.
    normals: u32,
    sun: vec3<f32>,
    baked_sun: vec3<f32>,
}

// Thirds of the first end of a block that a pixel has.
fn thirds(block: u32, at: vec2<u32>) -> u32 {
    let selector = (words[block + 1u] >> (2u * (4u * (at.y % 4u) + at.x % 4u))) & 3u;
    // By selector: 3, 0, 2, 1.
    return (0x63u >> (2u * selector)) & 3u;
}

fn stored_color(block: u32, at: vec2<u32>) -> vec3<f32> {
    let ends = words[block];
    let of_first = thirds(block, at);
    let mixed = of_first * block_end(ends & 0xffffu) + (3u - of_first) * block_end(ends >> 16u);
    return linear(mixed / 3u);
}

// Both ends of a block of normals are pairs of codes, the octahedron's middle at 128.
fn stored_normal(block: u32, at: vec2<u32>) -> vec3<f32> {
    let ends = (vec4<u32>(words[block]) >> vec4<u32>(0u, 8u, 16u, 24u)) & vec4<u32>(255u);
    let of_first = thirds(block, at);
    let code = (of_first * ends.xy + (3u - of_first) * ends.zw) / 3u;
    return unit(from_octahedral((vec2<f32>(code) - 128.0) / 127.0));
}

// Linear colour of a pixel and 1; all zero where its tile is not stored.
fn pixel(shown: Shown, at: vec2<u32>) -> vec4<f32> {
    let across = shown.side / 16u;
    let entry = words[shown.picture + at.y / 16u * across + at.x / 16u];
    if entry == 0u {
        return vec4<f32>(0.0);
    }
    let block = (entry - 1u) * 32u + ((at.y % 16u / 4u) * 4u + at.x % 16u / 4u) * 2u;
    let color = stored_color(shown.picture + across * across + block, at);
    if shown.normals == 0u {
        return vec4<f32>(color, 1.0);
    }
    let normal = stored_normal(shown.normals + block, at);
    return vec4<f32>(color * intensity(normal, shown.sun) / intensity(normal, shown.baked_sun), 1.0);
}

// Bilinear. What is not stored shows the nearest of the four pixels that is; black where none is.
fn sampled(shown: Shown, place: vec2<f32>) -> vec3<f32> {
    let from_center = clamp(place, vec2<f32>(0.0), vec2<f32>(f32(shown.side))) - 0.5;
    let below = floor(from_center);
    let share = from_center - below;
    let last = vec2<i32>(i32(shown.side) - 1);
    var sum = vec4<f32>(0.0);
    var nearest = vec3<f32>(0.0);
    var most = -1.0;
    for (var corner = 0u; corner < 4u; corner++) {
        let step = vec2<u32>(corner & 1u, corner >> 1u);
        let at = vec2<u32>(clamp(vec2<i32>(below) + vec2<i32>(step), vec2<i32>(0), last));
        let shares = select(1.0 - share, share, step == vec2<u32>(1u));
        let weight = shares.x * shares.y;
        let color = pixel(shown, at);
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
    let shown = Shown(in.picture, in.side, 0u, vec3<f32>(0.0), vec3<f32>(0.0));
    return vec4<f32>(sampled(shown, in.place), 1.0);
}

@fragment
fn fragment_relit(in: RelitOut) -> @location(0) vec4<f32> {
    guard(in.clip);
    let shown = Shown(in.picture, in.side, in.normals, in.sun, in.baked_sun);
    return vec4<f32>(sampled(shown, in.place), 1.0);
}

// A picture has no normals to be taken again.
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
