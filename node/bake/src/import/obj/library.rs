//! Materials of MTL files (Wavefront, *MTL material format*): diffuse colour, its picture, dissolve.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use super::map::Map;
use crate::import::builder::Paint;
use crate::import::emit::Emitter;
use crate::import::error::ImportError;
use crate::import::picture::{self, Picture, Square, linear_of};
use crate::import::text::{LineError, Lines, excerpt, number, words};
use crate::import::uri::Folder;
use crate::source::{Alpha, Surface, Texture, Wrap};

/// A material in use.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Material {
    /// Colour and surface.
    pub(super) paint: Paint,
    /// Mean of its picture in linear light; white without one.
    mean: [f64; 3],
    /// Scale and offset of texture coordinates.
    lookup: [[f64; 2]; 2],
}

impl Material {
    /// For faces without a material.
    const PLAIN: Self = Self { paint: Paint::PLAIN, mean: [1.0; 3], lookup: [[1.0; 2], [0.0; 2]] };

    /// The paint of faces without texture coordinates.
    pub(super) fn unmapped(&self) -> Paint {
        let mut paint = self.paint;
        paint.surface.texture = None;
        paint.color.iter_mut().zip(self.mean).for_each(|(lane, mean)| *lane *= mean);
        paint
    }

    /// Where the picture is looked up, from its top left corner, for a coordinate from its bottom
    /// left one.
    pub(super) fn looked_up(&self, coord: [f32; 2]) -> [f32; 2] {
        let [scale, offset] = self.lookup;
        let [u, v] = [0, 1].map(|lane| f64::from(coord[lane]) * scale[lane] + offset[lane]);
        [u as f32, (1.0 - v) as f32]
    }
}

/// A material as its file has it.
#[derive(Clone, Debug, PartialEq)]
struct Definition {
    /// sRGB-encoded.
    diffuse: Option<[f64; 3]>,
    dissolve: f64,
    map: Option<Map>,
}

impl Definition {
    const EMPTY: Self = Self { diffuse: None, dissolve: 1.0, map: None };
}

/// A picture in use.
#[derive(Clone, Copy)]
enum Had {
    Plain([f64; 3]),
    Texture { number: u32, mean: [f64; 3] },
}

/// All materials a scene names.
pub(super) struct Library<'a> {
    scene: &'a Path,
    definitions: BTreeMap<String, Definition>,
    /// Those in use; the first is for faces without one.
    materials: Vec<Material>,
    numbers: BTreeMap<String, usize>,
    /// Pictures by file and wrap mode; `None` where one cannot be had.
    pictures: BTreeMap<(String, bool), Option<Had>>,
    /// What was skipped, one sentence each.
    pub(super) notes: Vec<String>,
}

impl<'a> Library<'a> {
    /// Without materials; `scene` is the file that will name some.
    pub(super) fn new(scene: &'a Path) -> Self {
        Self {
            scene,
            definitions: BTreeMap::new(),
            materials: vec![Material::PLAIN],
            numbers: BTreeMap::new(),
            pictures: BTreeMap::new(),
            notes: Vec::new(),
        }
    }

    /// A material in use.
    pub(super) fn material(&self, number: usize) -> &Material {
        &self.materials[number]
    }

    /// The number of the material of this name, whose texture goes to `out` at its first use.
    pub(super) fn used(&mut self, name: &str, out: &mut Emitter<'_>) -> Result<usize, ImportError> {
        if let Some(&number) = self.numbers.get(name) {
            return Ok(number);
        }
        let number = match self.definitions.get(name).cloned() {
            Some(definition) => {
                let material = self.make(name, &definition, out)?;
                self.materials.push(material);
                self.materials.len() - 1
            }
            None => {
                if !name.is_empty() {
                    self.notes.push(format!("material {name:?} is not defined, white is used"));
                }
                0
            }
        };
        self.numbers.insert(name.to_owned(), number);
        Ok(number)
    }

    fn make(
        &mut self,
        name: &str,
        definition: &Definition,
        out: &mut Emitter<'_>,
    ) -> Result<Material, ImportError> {
        let mut material = Material::PLAIN;
        let mut diffuse =
            definition.diffuse.unwrap_or([1.0; 3]).map(|v| linear_of(v.clamp(0.0, 1.0)));
        if let Some(map) = &definition.map {
            match self.picture(name, map, out)? {
                None => {}
                Some(had) => {
                    // Some exporters write black beside a picture, where they mean the picture.
                    if diffuse == [0.0; 3] {
                        diffuse = [1.0; 3];
                    }
                    match had {
                        Had::Plain(color) => {
                            diffuse.iter_mut().zip(color).for_each(|(lane, plain)| *lane *= plain);
                        }
                        Had::Texture { number, mean } => {
                            material.paint.surface.texture = Some(number);
                            material.mean = mean;
                            material.lookup = [map.scale.unwrap_or([1.0; 2]), map.offset];
                        }
                    }
                }
            }
        }
        let alpha = definition.dissolve.clamp(0.0, 1.0);
        let [r, g, b] = diffuse;
        material.paint.color = [r, g, b, alpha];
        let mode = if alpha < 1.0 { Alpha::Blend } else { Alpha::Opaque };
        material.paint.surface = Surface { alpha: mode, ..material.paint.surface };
        Ok(material)
    }

    fn picture(
        &mut self,
        material: &str,
        map: &Map,
        out: &mut Emitter<'_>,
    ) -> Result<Option<Had>, ImportError> {
        let key = (map.file.clone(), map.clamps);
        if let Some(&known) = self.pictures.get(&key) {
            return Ok(known);
        }
        let at = format!("material {material:?}");
        let had = match self.load(&at, &map.file, out.limits.texture_side)? {
            Ok(Picture::Plain([r, g, b, _])) => Some(Had::Plain([r, g, b])),
            Ok(Picture::Square(Square { side, rgba, mean: [r, g, b, _], .. })) => {
                let wrap = [if map.clamps { Wrap::Clamp } else { Wrap::Repeat }; 2];
                let number = out.texture(Texture { name: map.file.clone(), side, rgba, wrap })?;
                Some(Had::Texture { number, mean: [r, g, b] })
            }
            Err(why) => {
                self.notes.push(format!("{at}: {why}, its colour alone is used"));
                None
            }
        };
        self.pictures.insert(key, had);
        Ok(had)
    }

    /// The inner error is why a picture cannot be had.
    fn load(
        &self,
        at: &str,
        name: &str,
        largest: u32,
    ) -> Result<Result<Picture, String>, ImportError> {
        let path = match self.locate(at, name) {
            Ok(path) => path,
            Err(ImportError::MissingResource { .. } | ImportError::OutsideFolder { .. }) => {
                return Ok(Err(format!("{name:?} is missing in the scene's folder")));
            }
            Err(error) => return Err(error),
        };
        let bytes =
            std::fs::read(&path).map_err(|source| ImportError::Read { file: path, source })?;
        Ok(match picture::decode(&bytes) {
            Ok(pixels) => Ok(picture::reduce(&pixels, false, largest)),
            Err(why) => Err(format!("{name:?} cannot be decoded ({why})")),
        })
    }

    /// The file of a name in the scene or a library. Modellers write paths of their own machine, and
    /// put the file beside the scene.
    fn locate(&self, at: &str, name: &str) -> Result<PathBuf, ImportError> {
        let folder = Folder { file: self.scene };
        let name = name.replace('\\', "/");
        folder.named(at, &name).or_else(|error| match name.rsplit_once('/') {
            Some((_, last)) => folder.named(at, last),
            None => Err(error),
        })
    }

    /// Reads the libraries of a line; one that is not there leaves a note.
    pub(super) fn read(&mut self, at: u64, names: &str) -> Result<(), ImportError> {
        let at = format!("line {at}");
        // A name may hold blanks, and a line may hold several names.
        let whole = self.locate(&at, names);
        let all: Vec<(&str, Result<_, _>)> = match whole {
            Ok(path) => vec![(names, Ok(path))],
            Err(_) => names.split_whitespace().map(|name| (name, self.locate(&at, name))).collect(),
        };
        for (name, path) in all {
            match path {
                Ok(path) => {
                    let unreadable = |source| ImportError::Read { file: path.clone(), source };
                    let file = File::open(&path).map_err(unreadable)?;
                    self.parse(&path, BufReader::new(file))?;
                    // What was asked for too early may be defined by now.
                    self.numbers.retain(|_, number| *number != 0);
                }
                Err(ImportError::MissingResource { .. } | ImportError::OutsideFolder { .. }) => {
                    self.notes.push(format!(
                        "{name:?} is missing in the scene's folder, its materials are white"
                    ));
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn parse(&mut self, file: &Path, reader: impl BufRead) -> Result<(), ImportError> {
        let broken = |at: u64, what: String| ImportError::Invalid {
            file: file.into(),
            at: format!("line {at}"),
            what,
            fix: "export or copy the file again",
        };
        let mut lines = Lines::new(reader);
        let mut present: Option<&mut Definition> = None;
        let mut masks = 0u64;
        loop {
            let (at, line) = match lines.next(true) {
                Ok(Some(line)) => line,
                Ok(None) => break,
                Err(LineError::Io(source)) => {
                    return Err(ImportError::Read { file: file.into(), source });
                }
                Err(LineError::TooLong { line }) => {
                    return Err(broken(line, "it is too long".into()));
                }
            };
            let mut words = words(line);
            let Some(word) = words.next() else { continue };
            let wrong = || broken(at, format!("\"{}\" is not understood", excerpt(line)));
            let rest = String::from_utf8_lossy(line[word.len()..].trim_ascii());
            if word == b"newmtl" {
                let entry = self.definitions.entry(rest.into_owned()).or_insert(Definition::EMPTY);
                *entry = Definition::EMPTY;
                present = Some(entry);
                continue;
            }
            let Some(material) = present.as_deref_mut() else { continue };
            match word {
                b"Kd" => {
                    let lanes: Vec<f64> = words.map_while(number).take(3).collect();
                    match lanes[..] {
                        [r, g, b] => material.diffuse = Some([r, g, b]),
                        // One number stands for all three; spectral curves and XYZ give none.
                        [grey] => material.diffuse = Some([grey; 3]),
                        _ => {}
                    }
                }
                b"d" => {
                    let value = words.find(|word| *word != b"-halo").and_then(number);
                    material.dissolve = value.ok_or_else(wrong)?;
                }
                b"Tr" => {
                    material.dissolve = 1.0 - words.next().and_then(number).ok_or_else(wrong)?;
                }
                b"map_Kd" => material.map = Map::of(&rest),
                b"map_d" => masks += 1,
                _ => {}
            }
        }
        if masks > 0 {
            self.notes.push(format!("{masks} transparency pictures (map_d) ignored"));
        }
        Ok(())
    }
}
