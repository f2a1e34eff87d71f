//! Which device a path stands for: its stable name, its driver, who else has it open.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Where udev keeps links that follow a device from port to port.
const BY_ID: &str = "/dev/serial/by-id";
const SYS_TTY: &str = "/sys/class/tty";

/// The name under which a device will be found again after it was unplugged.
///
/// A link the user gave is kept. For a bare device it is the link in `/dev/serial/by-id` that
/// points to it now, because ttyUSB0 may come back as ttyUSB1, and something else as ttyUSB0.
pub(crate) fn stable_name(path: &Path) -> PathBuf {
    let is_link = fs::symlink_metadata(path).is_ok_and(|m| m.is_symlink());
    if is_link { None } else { link_to(path, Path::new(BY_ID)) }.unwrap_or_else(|| path.into())
}

/// The link in `folder` that points to `device`.
fn link_to(device: &Path, folder: &Path) -> Option<PathBuf> {
    let device = fs::canonicalize(device).ok()?;
    let mut links: Vec<_> = fs::read_dir(folder).ok()?.flatten().map(|e| e.path()).collect();
    links.sort();
    links.into_iter().find(|link| fs::canonicalize(link).is_ok_and(|d| d == device))
}

/// The link in `/dev/serial/by-id`, if there is one.
pub(crate) fn by_id(device: &Path) -> Option<PathBuf> {
    link_to(device, Path::new(BY_ID))
}

/// What sysfs knows of a tty: `driver`, `usb` (vendor:product), `manufacturer`, `product`,
/// `serial_number`.
pub(crate) fn hardware(device: &Path) -> BTreeMap<String, String> {
    hardware_in(device, Path::new(SYS_TTY))
}

fn hardware_in(device: &Path, sys: &Path) -> BTreeMap<String, String> {
    let mut facts = BTreeMap::new();
    let device = fs::canonicalize(device).unwrap_or_else(|_| device.to_owned());
    let Some(name) = device.file_name() else { return facts };
    let node = sys.join(name).join("device");
    if let Ok(driver) = fs::canonicalize(node.join("driver"))
        && let Some(driver) = driver.file_name()
    {
        facts.insert("driver".to_owned(), driver.to_string_lossy().into_owned());
    }
    // A USB port hangs below its interface, and that below the USB device with the names.
    let Ok(node) = fs::canonicalize(&node) else { return facts };
    let Some(usb) = node.ancestors().find(|a| a.join("idVendor").is_file()) else { return facts };
    let read = |file: &str| {
        let text = fs::read_to_string(usb.join(file)).ok()?;
        Some(text.trim().to_owned()).filter(|t| !t.is_empty())
    };
    if let (Some(vendor), Some(product)) = (read("idVendor"), read("idProduct")) {
        facts.insert("usb".to_owned(), format!("{vendor}:{product}"));
    }
    for (file, name) in
        [("manufacturer", "manufacturer"), ("product", "product"), ("serial", "serial_number")]
    {
        if let Some(text) = read(file) {
            facts.insert(name.to_owned(), text);
        }
    }
    facts
}

/// Another process that has a device open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Holder {
    pub pid: u32,
    pub name: String,
}

impl Holder {
    /// True if the process has the master side of the pseudo-terminal `device` (a line `tty-index` of
    /// its `fdinfo`, since Linux 4.14): then it made it, and takes no share of what is read here.
    pub fn made(&self, device: &Path) -> bool {
        let device = fs::canonicalize(device).unwrap_or_default();
        let Some(number) = device.strip_prefix("/dev/pts").ok().and_then(Path::to_str) else {
            return false;
        };
        let Ok(files) = fs::read_dir(format!("/proc/{}/fdinfo", self.pid)) else { return false };
        let own = |text: String| {
            let mut index = text.lines().filter_map(|line| line.strip_prefix("tty-index:"));
            index.any(|index| index.trim() == number)
        };
        files.flatten().any(|file| fs::read_to_string(file.path()).is_ok_and(own))
    }
}

/// The other processes that have `device` open, as far as we may look into them (proc(5)).
pub(crate) fn holders(device: &Path) -> Vec<Holder> {
    let Ok(device) = fs::canonicalize(device) else { return Vec::new() };
    let Ok(processes) = fs::read_dir("/proc") else { return Vec::new() };
    let mut found = Vec::new();
    for process in processes.flatten() {
        let pid = process.file_name().to_str().and_then(|n| n.parse().ok());
        let Some(pid) = pid.filter(|&p| p != std::process::id()) else { continue };
        let Ok(mut files) = fs::read_dir(process.path().join("fd")) else { continue };
        if files.any(|f| f.is_ok_and(|f| fs::read_link(f.path()).is_ok_and(|d| d == device))) {
            let name = fs::read_to_string(process.path().join("comm")).unwrap_or_default();
            found.push(Holder { pid, name: name.trim().to_owned() });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn a_usb_port_is_described_by_the_device_it_hangs_on() {
        let root = tempfile::tempdir().unwrap();
        let usb = root.path().join("devices/usb1/1-2");
        let port = usb.join("1-2:1.0/ttyUSB7");
        fs::create_dir_all(&port).unwrap();
        fs::create_dir_all(root.path().join("drivers/ftdi_sio")).unwrap();
        symlink(root.path().join("drivers/ftdi_sio"), port.join("driver")).unwrap();
        for (file, text) in [("idVendor", "0403\n"), ("idProduct", "6001\n"), ("serial", "A5\n")] {
            fs::write(usb.join(file), text).unwrap();
        }
        let class = root.path().join("class/ttyUSB7");
        fs::create_dir_all(&class).unwrap();
        symlink(&port, class.join("device")).unwrap();

        let facts = hardware_in(Path::new("/dev/ttyUSB7"), &root.path().join("class"));
        let expected = [("driver", "ftdi_sio"), ("serial_number", "A5"), ("usb", "0403:6001")];
        assert!(facts.iter().map(|(k, v)| (k.as_str(), v.as_str())).eq(expected), "{facts:?}");
    }

    #[test]
    fn a_device_is_found_again_by_the_link_that_points_to_it() {
        let root = tempfile::tempdir().unwrap();
        let (device, other) = (root.path().join("ttyUSB0"), root.path().join("ttyUSB1"));
        fs::write(&device, "").unwrap();
        fs::write(&other, "").unwrap();
        let folder = root.path().join("by-id");
        fs::create_dir(&folder).unwrap();
        symlink(&other, folder.join("usb-a")).unwrap();
        symlink("../ttyUSB0", folder.join("usb-b")).unwrap();
        assert_eq!(link_to(&device, &folder), Some(folder.join("usb-b")));
        assert_eq!(link_to(&folder, &folder), None);
        assert_eq!(stable_name(&folder.join("usb-a")), folder.join("usb-a"));
        assert_eq!(stable_name(&device), device);
    }

    #[test]
    fn who_else_has_a_file_open_is_found() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut child = std::process::Command::new("sleep")
            .arg("5")
            .stdin(fs::File::open(file.path()).unwrap())
            .spawn()
            .unwrap();
        std::thread::sleep(std::time::Duration::from_millis(100));
        let found = holders(file.path());
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(found, [Holder { pid: child.id(), name: "sleep".to_owned() }]);
    }
}
