//! The path under which an application finds our pseudo-terminal.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::capture::CaptureError;

/// A symlink that we made; removed on drop, unless somebody has put something else there.
#[derive(Debug)]
pub(crate) struct Link {
    path: PathBuf,
    target: PathBuf,
}

impl Link {
    /// Links `path` to `target`, a terminal just made. Replaces only a symlink that leads nowhere, or
    /// there, as a recorder that was killed leaves behind.
    pub fn make(path: &Path, target: &Path) -> Result<Self, CaptureError> {
        if let Ok(there) = fs::symlink_metadata(path) {
            // Ours is new, so nobody can have linked to it: one that was killed had its number.
            let left = there.is_symlink() && fs::read_link(path).is_ok_and(|to| to == target);
            if !left && (path.exists() || !there.is_symlink()) {
                let leads = fs::read_link(path)
                    .map(|t| format!(", which leads to {}", t.display()))
                    .unwrap_or_default();
                return Err(CaptureError(format!(
                    "cannot make a pseudo-terminal at {}: something is there already{leads}; \
                     remove it or choose another path",
                    path.display()
                )));
            }
            // Should it vanish on its own meanwhile, so much the better.
            let _ = fs::remove_file(path);
        }
        std::os::unix::fs::symlink(target, path).map_err(|error| cannot(path, &error))?;
        Ok(Self { path: path.to_owned(), target: target.to_owned() })
    }
}

fn cannot(path: &Path, error: &io::Error) -> CaptureError {
    let hint = match error.kind() {
        io::ErrorKind::NotFound => "; its folder does not exist",
        io::ErrorKind::PermissionDenied => "; choose a folder that you may write to",
        _ => "",
    };
    CaptureError(format!("cannot make a pseudo-terminal at {}: {error}{hint}", path.display()))
}

impl Drop for Link {
    fn drop(&mut self) {
        if fs::read_link(&self.path).is_ok_and(|target| target == self.target) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn only_a_link_that_leads_nowhere_is_replaced_and_only_our_own_is_removed() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("tty");
        let target = root.path().join("target");
        fs::write(&target, "").unwrap();

        symlink("/nowhere/at/all", &path).unwrap();
        let link = Link::make(&path, &target).unwrap();
        let other = root.path().join("other");
        let error = Link::make(&path, &other).unwrap_err().to_string();
        assert!(error.contains("something is there already, which leads to"), "{error}");
        drop(link);
        assert!(fs::symlink_metadata(&path).is_err());

        // The number of a terminal is given to the next one.
        symlink(&target, &path).unwrap();
        drop(Link::make(&path, &target).unwrap());
        assert!(fs::symlink_metadata(&path).is_err());

        fs::write(&path, "mine").unwrap();
        assert!(Link::make(&path, &target).is_err());
        assert_eq!(fs::read(&path).unwrap(), b"mine");
        fs::remove_file(&path).unwrap();

        let link = Link::make(&path, &target).unwrap();
        fs::remove_file(&path).unwrap();
        fs::write(&path, "somebody else's").unwrap();
        drop(link);
        assert!(path.exists());

        let error = Link::make(&root.path().join("no/tty"), &target).unwrap_err().to_string();
        assert!(error.contains("its folder does not exist"), "{error}");
    }
}
