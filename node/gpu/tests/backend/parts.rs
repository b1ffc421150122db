//! Passes in parts, with meshes evicted and uploaded between them, against the same passes whole.

use crate::support::{backend_within, lit_with_depth, random_box, run, vertex, view};
use protocol::format::texture::mips;
use protocol::format::vertex::Layout;
use protocol::format::{Blob, Class, NONE, Texture, TexturedVertex};
use protocol::id::{BlobId, HlodId};
use protocol::settings::Cull;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use scene::backend::cpu::CpuBackend;
use scene::backend::{
    Backend, BoxQuery, Completion, Draw, Draws, NO_ITEM, Part, Pass, Shading, UNLIMITED, Upload,
    upload_textures,
};

const WIDTH: u32 = 97;
const HEIGHT: u32 = 61;
/// Places along an axis: few, so that many triangles lie at one depth.
const PLACES: i32 = 12;
/// A budget in bytes that most crowds exceed.
const TIGHT: u64 = 24 << 10;

/// Meshes of squares that face the eye, of all classes, and draws of them, several a mesh.
struct Crowd {
    blobs: Vec<(Blob, Vec<u8>)>,
    draws: Draws,
    textures: Vec<(Texture, Vec<u8>)>,
    boxes: Vec<BoxQuery>,
}

impl Crowd {
    fn new(seed: u64) -> Self {
        let random = &mut StdRng::seed_from_u64(seed);
        let blobs: Vec<_> = (0..24).map(|_| squares(random)).collect();
        let textures = [4, 16].map(|side| {
            let rgba: Vec<u8> = (0..4 * side * side).map(|_| random.random()).collect();
            let bytes = mips(side, &rgba);
            let length = bytes.len() as u64;
            (Texture { offset: 0, bytes: length, side, wrap: 0, crc: 0, reserved: 0 }, bytes)
        });
        let mut all: Vec<Draw> =
            (0..90).map(|item| placed(random, item, blobs.len() as u32)).collect();
        all.sort_by_key(|draw| (draw.blob, draw.item));
        let having = |wanted: fn(Class) -> bool| -> Vec<Draw> {
            let has = |draw: &&Draw| {
                let blob = &blobs[draw.blob.index()].0;
                Class::ALL.into_iter().any(|class| wanted(class) && blob.has(class))
            };
            all.iter().filter(has).copied().collect()
        };
        let (solid, mut blending) = (having(|class| !class.is_blend()), having(Class::is_blend));
        blending.sort_by(|a, b| b.distance.total_cmp(&a.distance));
        let boxes = (0..300).map(|_| random_box(random, 64..1200, 40)).collect();
        Self { blobs, draws: Draws { solid, blending }, textures: textures.into(), boxes }
    }

    fn textures(&self, backend: &mut impl Backend) {
        let textures: Vec<_> = self.textures.iter().map(|(t, bytes)| (*t, &bytes[..])).collect();
        assert_eq!(upload_textures(backend, &textures).expect("sound textures"), Upload::Done);
    }

    fn upload(&self, backend: &mut impl Backend, id: u32) -> Upload {
        let (blob, bytes) = &self.blobs[id as usize];
        backend.upload(BlobId(id), blob, bytes).expect("a sound blob")
    }

    /// Both lists cut at places, each of them with a chance of `share`; what blends comes last.
    fn cut(&self, random: &mut StdRng, share: f64) -> Vec<Draws> {
        let mut cut = || random.random_bool(share);
        let solid = self.draws.solid.chunk_by(|a, b| a.blob == b.blob || !cut());
        let mut parts: Vec<Draws> =
            solid.map(|solid| Draws { solid: solid.to_vec(), blending: vec![] }).collect();
        for (i, draw) in self.draws.blending.iter().enumerate() {
            match parts.last_mut() {
                Some(last) if !random.random_bool(share) => last.blending.push(*draw),
                _ => parts.push(Draws { solid: vec![], blending: vec![self.draws.blending[i]] }),
            }
        }
        parts
    }
}

/// A mesh of up to 30 squares at few places; two out of three are of all classes.
fn squares(random: &mut StdRng) -> (Blob, Vec<u8>) {
    let textured = random.random_bool(0.4);
    let mut of_class: Vec<Class> = (0..random.random_range(1..30))
        .map(|_| Class::ALL[random.random_range(0..Class::COUNT)])
        .map(|class| if class.is_mask() && !textured { Class::BlendDouble } else { class })
        .collect();
    if random.random_bool(0.3) {
        of_class.fill(Class::OpaqueDouble);
    }
    of_class.sort_unstable();
    let (mut vertices, mut indices, mut classes) = (Vec::new(), Vec::new(), [0; Class::COUNT]);
    for (class, first) in of_class.iter().zip((0u16..).step_by(4)) {
        classes[*class as usize] += 2;
        let mut place = || random.random_range(0..PLACES as u32);
        let [x, y, z] = [place(), place(), place()];
        let color = random.random::<u32>() | 0x4000_0000;
        for [dx, dy] in [[0, 0], [3, 0], [0, 3], [3, 3]] {
            let plain = vertex([x + dx, y + dy, z], [0.0, 0.6, 0.8], color);
            vertices.extend_from_slice(bytemuck::bytes_of(&plain));
            if textured {
                let texture = [NONE, 0, 1][random.random_range(0..3)];
                let tex_coord = [dx as f32 * 0.4, dy as f32 * 0.3];
                let whole = TexturedVertex { plain, tex_coord, texture, cutoff: 0.4 };
                vertices.extend_from_slice(&bytemuck::bytes_of(&whole)[16..]);
            }
        }
        indices.extend([0, 1, 2, 1, 3, 2].map(|corner| first + corner));
    }
    let squares = of_class.len() as u32;
    let layout = if textured { Layout::Textured } else { Layout::Plain } as u32;
    let blob =
        Blob { vertices: 4 * squares, triangles: 2 * squares, layout, classes, ..Blob::default() };
    vertices.extend_from_slice(bytemuck::cast_slice(&indices));
    (blob, vertices)
}

/// A draw at a place from which the squares of all meshes share depths; some are mirrored.
fn placed(random: &mut StdRng, item: u32, blobs: u32) -> Draw {
    let mut place = |least: i32| random.random_range(least..least + PLACES) as f32 / 4.0;
    let mut offset = [place(-14), place(-12), place(-20)];
    let mut linear = [[0.25, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, -0.25]];
    if random.random_bool(0.3) {
        linear[0][0] = -0.25;
        offset[0] += 3.0;
    }
    let distance = random.random_range(1..9) as f32;
    let blob = BlobId(random.random_range(0..blobs));
    Draw { blob, item: HlodId(item), linear, offset, distance, disparity_step: 0.0 }
}

/// What a backend makes of the parts: picture and depth, items, and which boxes are seen behind the
/// occluders. Before each part, what it does not need may go and what it needs comes.
fn seen(
    backend: &mut impl Backend,
    crowd: &Crowd,
    parts: &[Draws],
    random: &mut StdRng,
    budget: u64,
) -> Vec<Completion> {
    let view = view(WIDTH, HEIGHT);
    let mut held: Vec<u32> = Vec::new();
    let mut answers = Vec::new();
    let kinds: [fn(_, Draws, Part) -> Pass; 4] = [
        lit_with_depth,
        |view, draws, part| Pass::Shade {
            view,
            shading: Shading::Normals,
            draws,
            with_depth: true,
            part,
        },
        |view, draws, part| Pass::Items { view, draws, part },
        |view, draws, part| Pass::Occluders { view, draws: draws.solid, adds: false, part },
    ];
    for pass in kinds {
        for (at, draws) in parts.iter().enumerate() {
            let needs =
                |id: &u32| draws.solid.iter().chain(&draws.blending).any(|draw| draw.blob.0 == *id);
            held.retain(|id| {
                let stays = needs(id) || random.random_bool(0.5);
                if !stays {
                    backend.evict(BlobId(*id));
                }
                stays
            });
            for id in (0..crowd.blobs.len() as u32).filter(needs) {
                while !held.contains(&id) {
                    match crowd.upload(backend, id) {
                        Upload::Done => held.push(id),
                        Upload::Full => {
                            let spare = held.iter().position(|id| !needs(id));
                            backend.evict(BlobId(held.remove(spare.expect("a part fits"))));
                        }
                    }
                    assert!(backend.held_bytes() <= budget);
                }
            }
            let part = Part { opens: at == 0, closes: at + 1 == parts.len() };
            backend.submit(pass(view, draws.clone(), part)).expect("a sound part");
            if !part.closes {
                let mut none = Vec::new();
                backend.poll(&mut none).expect("a working device");
                assert_eq!(none, [], "only the part that closes is answered");
            }
        }
        backend.poll(&mut answers).expect("a working device");
    }
    let boxes = crowd.boxes.clone();
    answers.extend(run(backend, Pass::QueryBoxes { view, boxes, method: Cull::Queries }));
    // Tickets are counted on.
    for answer in &mut answers {
        let (Completion::Picture { ticket, .. }
        | Completion::Items { ticket, .. }
        | Completion::Occluders { ticket }
        | Completion::Boxes { ticket, .. }) = answer;
        ticket.0 = 0;
    }
    assert_eq!(answers.len(), 5);
    answers
}

/// Draws crowds whole and in parts, with all the memory there is and with little.
fn parts_change_no_bit(roomy: &mut impl Backend, tight: &mut impl Backend) {
    for seed in 0..8 {
        let crowd = Crowd::new(seed);
        let random = &mut StdRng::seed_from_u64(seed);
        for id in (0..crowd.blobs.len() as u32).map(BlobId) {
            roomy.evict(id);
            tight.evict(id);
        }
        crowd.textures(roomy);
        crowd.textures(tight);
        let whole = seen(roomy, &crowd, std::slice::from_ref(&crowd.draws), random, UNLIMITED);
        proves_something(&whole);
        for share in [0.1, 0.5, 1.0] {
            let parts = crowd.cut(random, share);
            assert!(seen(roomy, &crowd, &parts, random, UNLIMITED) == whole, "{seed}, {share}");
        }
        for share in [0.6, 1.0] {
            let parts = crowd.cut(random, share);
            assert!(seen(tight, &crowd, &parts, random, TIGHT) == whole, "{seed}, {share}, tight");
        }
        // Depths are equal in many places: another order is another picture.
        let mut draws = crowd.draws.clone();
        draws.solid.reverse();
        assert!(seen(roomy, &crowd, &[draws], random, UNLIMITED) != whole, "{seed}");
    }
}

fn proves_something(answers: &[Completion]) {
    let [_, _, Completion::Items { items, blended, .. }, _, Completion::Boxes { visible, .. }] =
        answers
    else {
        panic!("four answers")
    };
    for layer in [items, blended] {
        let mut distinct = layer.clone();
        distinct.sort_unstable();
        distinct.dedup();
        assert!(distinct.len() > 8 && distinct.contains(&NO_ITEM), "{}", distinct.len());
    }
    let seen = visible.iter().filter(|&&seen| seen).count();
    assert!(seen > 20 && seen + 20 < visible.len(), "{seen} of {}", visible.len());
}

#[test]
fn parts_change_no_bit_of_the_driver_s_pictures() {
    let Some(mut roomy) = backend_within(WIDTH, HEIGHT, UNLIMITED) else { return };
    let Some(mut tight) = backend_within(WIDTH, HEIGHT, TIGHT) else { return };
    parts_change_no_bit(&mut roomy, &mut tight);
}

#[test]
fn parts_change_no_bit_of_the_rasteriser_s_pictures() {
    let backend = || CpuBackend::new(view(WIDTH, HEIGHT).size);
    parts_change_no_bit(&mut backend(), &mut backend().with_budget(TIGHT));
}
