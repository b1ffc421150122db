//! Every source parses and validates, and its structs are those of the Rust mirrors.

use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{Binding, Module, Scalar, ScalarKind, StructMember, TypeInner, VectorSize};
use shaders::mirror::{
    BoxInstance, Field, Frame, Instance, Kind, TextureRecord, Texturing, Vertex,
};

const SOURCES: [(&str, &str, &[&str]); 9] = [
    ("DEPTH", shaders::DEPTH, &["vertex_main", "fragment_guard"]),
    (
        "SHADE",
        shaders::SHADE,
        &["vertex_main", "fragment_main", "fragment_blend", "fragment_normal"],
    ),
    (
        "SHADE_TEXTURED",
        shaders::SHADE_TEXTURED,
        &["vertex_main", "fragment_main", "fragment_blend", "fragment_normal"],
    ),
    (
        "SHADE_MASK",
        shaders::SHADE_MASK,
        &[
            "vertex_main",
            "fragment_main",
            "fragment_blend",
            "fragment_normal",
            "fragment_mask",
            "fragment_mask_normal",
        ],
    ),
    ("ITEMS_MASK", shaders::ITEMS_MASK, &["vertex_main", "fragment_main"]),
    ("ITEMS", shaders::ITEMS, &["vertex_main", "fragment_main"]),
    (
        "PROJECTED",
        shaders::PROJECTED,
        &[
            "vertex_main",
            "vertex_relit",
            "fragment_main",
            "fragment_relit",
            "fragment_normal",
            "fragment_items",
            "fragment_guard",
        ],
    ),
    ("BOX_QUERY", shaders::BOX_QUERY, &["query_vertex"]),
    ("BOX_MARK", shaders::BOX_MARK, &["mark_vertex", "mark_fragment"]),
];

/// As drivers take it; sources without `guard` as they are.
fn parse(name: &str, source: &str) -> Module {
    let guarded = [true, false].map(|guards| match source.contains("guard(") {
        true => shaders::for_meshes(source, guards),
        false => source.to_owned(),
    });
    let [module, _] = guarded.map(|source| valid(name, &source));
    module
}

fn valid(name: &str, source: &str) -> Module {
    let module =
        naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{name}: {e}\n{source}"));
    Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{name}: {}", e.emit_to_string(source)));
    module
}

/// Members and size of a struct, if the module has it.
fn structure(module: &Module, name: &str) -> Option<(Vec<StructMember>, usize)> {
    module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name)).map(|(_, t)| {
        let TypeInner::Struct { members, span } = &t.inner else {
            panic!("{name} is not a struct");
        };
        (members.clone(), *span as usize)
    })
}

fn kind(module: &Module, member: &StructMember) -> Option<Kind> {
    let is = |s: &Scalar, kind| s.kind == kind && s.width == 4;
    match &module.types[member.ty].inner {
        TypeInner::Scalar(s) if is(s, ScalarKind::Uint) => Some(Kind::Uint32),
        TypeInner::Scalar(s) if is(s, ScalarKind::Float) => Some(Kind::Float32),
        TypeInner::Vector { size: VectorSize::Bi, scalar } if is(scalar, ScalarKind::Uint) => {
            Some(Kind::Uint32x2)
        }
        TypeInner::Vector { size: VectorSize::Bi, scalar } if is(scalar, ScalarKind::Float) => {
            Some(Kind::Float32x2)
        }
        TypeInner::Vector { size: VectorSize::Tri, scalar } if is(scalar, ScalarKind::Float) => {
            Some(Kind::Float32x3)
        }
        TypeInner::Matrix { columns: VectorSize::Quad, rows: VectorSize::Quad, scalar }
            if is(scalar, ScalarKind::Float) =>
        {
            Some(Kind::Matrix4)
        }
        _ => None,
    }
}

/// A struct in memory: names, kinds, offsets and size agree.
fn check_memory(source: &str, module: &Module, name: &str, fields: &[Field], size: usize) {
    let (members, span) = structure(module, name).unwrap_or_else(|| panic!("{source}: no {name}"));
    let found: Vec<_> =
        members.iter().map(|m| (m.name.clone(), m.offset as usize, kind(module, m))).collect();
    let mirror: Vec<_> =
        fields.iter().map(|f| (Some(f.name.to_owned()), f.offset, Some(f.kind))).collect();
    assert_eq!(found, mirror, "{source}: {name}");
    assert_eq!(span, size, "{source}: size of {name}");
}

/// A struct of vertex attributes: names, kinds and locations agree, and the mirror has no holes.
fn check_attributes(
    module: &Module,
    name: &str,
    first: u32,
    fields: &[Field],
    size: usize,
) -> bool {
    let Some((members, _)) = structure(module, name) else { return false };
    let found: Vec<_> = members
        .iter()
        .map(|m| match m.binding {
            Some(Binding::Location { location, .. }) => (m.name.clone(), location, kind(module, m)),
            _ => panic!("{name}: a member is not an attribute"),
        })
        .collect();
    let mirror: Vec<_> = fields
        .iter()
        .zip(first..)
        .map(|(f, location)| (Some(f.name.to_owned()), location, Some(f.kind)))
        .collect();
    assert_eq!(found, mirror, "{name}");
    let mut end = 0;
    for field in fields {
        assert_eq!(field.offset, end, "{name}.{}", field.name);
        end += field.kind.size();
    }
    assert_eq!(end, size, "{name}");
    true
}

#[test]
fn every_source_is_valid_and_has_its_entry_points() {
    for (name, source, entries) in SOURCES {
        let module = parse(name, source);
        let found: Vec<_> = module.entry_points.iter().map(|e| e.name.as_str()).collect();
        assert_eq!(found, entries, "{name}");
    }
}

#[test]
fn every_mirror_agrees_with_every_source_that_has_it() {
    let mut seen = [0; 4];
    let mut records = 0;
    for (name, source, _) in SOURCES {
        let module = parse(name, source);
        check_memory(name, &module, "Frame", Frame::FIELDS, size_of::<Frame>());
        if structure(&module, "TextureRecord").is_some() {
            let size = size_of::<TextureRecord>();
            check_memory(name, &module, "TextureRecord", TextureRecord::FIELDS, size);
            records += 1;
        }
        let attributes = [
            ("Vertex", Vertex::FIRST_LOCATION, Vertex::FIELDS, size_of::<Vertex>()),
            ("Texturing", Texturing::FIRST_LOCATION, Texturing::FIELDS, size_of::<Texturing>()),
            ("Instance", Instance::FIRST_LOCATION, Instance::FIELDS, size_of::<Instance>()),
            (
                "BoxInstance",
                BoxInstance::FIRST_LOCATION,
                BoxInstance::FIELDS,
                size_of::<BoxInstance>(),
            ),
        ];
        for (count, (name, first, fields, size)) in seen.iter_mut().zip(attributes) {
            *count += usize::from(check_attributes(&module, name, first, fields, size));
        }
    }
    assert_eq!(seen, [7, 3, 7, 2], "Vertex, Texturing, Instance, BoxInstance");
    assert_eq!(records, 3, "TextureRecord");
}

#[test]
fn every_position_is_invariant() {
    for (name, source, _) in SOURCES {
        assert_eq!(
            source.matches("@builtin(position)").count(),
            // A fragment's own is as it comes.
            source.matches("@invariant @builtin(position)").count()
                + source.matches("(@builtin(position)").count(),
            "{name}"
        );
    }
}

#[test]
fn only_what_has_holes_discards() {
    for (name, source, _) in SOURCES {
        assert_eq!(source.contains("discard"), name.ends_with("_MASK"), "{name}");
    }
}

#[test]
fn the_guard_stands_in_every_fragment_of_a_mesh_and_discards_only_where_asked_for() {
    for (name, source, _) in SOURCES.into_iter().filter(|(name, ..)| !name.starts_with("BOX")) {
        let count = |what| source.matches(what).count();
        assert_eq!(count("@fragment"), count("    guard("), "{name}");
        let discards = |guards| shaders::for_meshes(source, guards).matches("discard").count();
        assert_eq!(discards(true), discards(false) + 1, "{name}");
    }
}

#[test]
fn hidden_fragments_mark_nothing() {
    let module = parse("BOX_MARK", shaders::BOX_MARK);
    let fragment = module.entry_points.iter().find(|e| e.name == "mark_fragment").unwrap();
    assert_eq!(fragment.early_depth_test, Some(naga::EarlyDepthTest::Force));
}
