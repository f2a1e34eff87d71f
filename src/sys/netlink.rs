//! The bytes of rtnetlink's link messages.
//!
//! Sources: netlink(7), rtnetlink(7), `linux/netlink.h`, `linux/if_link.h`. All numbers are in the
//! machine's byte order; messages and attributes start on 4-byte boundaries.

use super::link::Link;

/// Length of a `struct nlmsghdr`.
const HEADER: usize = 16;
/// Length of a `struct ifinfomsg`.
const INFO: usize = 16;
/// Length of a `struct rtattr`.
const ATTRIBUTE: usize = 4;
/// Interface names are at most 15 bytes; the kernel refuses longer ones itself.
const NAME_MAX: usize = 255;
/// Flags in the upper two bits of an attribute's type.
const TYPE_MASK: u16 = 0x3FFF;

/// One message of an answer.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum LinkMessage {
    /// An interface.
    Link(Link),
    /// The request was refused with this error number, or with 0 accepted.
    Error(i32),
    /// The end of a dump.
    Done,
}

/// A request for the interface with this name, or for all of them.
pub(super) fn request(name: Option<&str>) -> Vec<u8> {
    let mut body = vec![0; INFO];
    // Counters of bytes and packets are not needed.
    attribute(&mut body, libc::IFLA_EXT_MASK, &RTEXT_FILTER_SKIP_STATS.to_ne_bytes());
    let Some(name) = name else { return message(libc::RTM_GETLINK, libc::NLM_F_DUMP, &body) };
    let name = name.as_bytes();
    let mut text = name[..name.len().min(NAME_MAX)].to_vec();
    text.push(0);
    attribute(&mut body, libc::IFLA_IFNAME, &text);
    message(libc::RTM_GETLINK, libc::NLM_F_ACK, &body)
}

/// A request to take an interface up or down.
pub(super) fn request_up(index: u32, up: bool) -> Vec<u8> {
    let mut body = info(index);
    let bit = libc::IFF_UP.cast_unsigned().to_ne_bytes();
    body[8..12].copy_from_slice(if up { &bit } else { &[0; 4] });
    body[12..16].copy_from_slice(&bit);
    message(libc::RTM_NEWLINK, libc::NLM_F_ACK, &body)
}

/// A request to run a CAN controller at these bit rates, with CAN FD if there is a second.
pub(super) fn request_bitrate(index: u32, bitrate: u32, data: Option<u32>) -> Vec<u8> {
    // struct can_bittiming: with nothing but a bit rate the kernel works out the rest.
    let timing = |bitrate: u32| {
        let mut timing = [0; 32];
        timing[..4].copy_from_slice(&bitrate.to_ne_bytes());
        timing
    };
    let mut settings = Vec::new();
    attribute(&mut settings, libc::IFLA_CAN_BITTIMING as u16, &timing(bitrate));
    if let Some(data) = data {
        attribute(&mut settings, libc::IFLA_CAN_DATA_BITTIMING as u16, &timing(data));
        // struct can_ctrlmode: which modes to change, and to what.
        let fd = libc::CAN_CTRLMODE_FD.to_ne_bytes();
        attribute(&mut settings, libc::IFLA_CAN_CTRLMODE as u16, &[fd, fd].concat());
    }
    let mut link = Vec::new();
    attribute(&mut link, libc::IFLA_INFO_KIND, b"can\0");
    attribute(&mut link, libc::IFLA_INFO_DATA, &settings);
    let mut body = info(index);
    attribute(&mut body, libc::IFLA_LINKINFO, &link);
    message(libc::RTM_NEWLINK, libc::NLM_F_ACK, &body)
}

/// A `struct ifinfomsg` that names an interface and changes no flags.
fn info(index: u32) -> Vec<u8> {
    let mut info = vec![0; INFO];
    info[4..8].copy_from_slice(&index.to_ne_bytes());
    info
}

fn message(kind: u16, flags: i32, body: &[u8]) -> Vec<u8> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "16-bit flags")]
    let flags = (flags | libc::NLM_F_REQUEST) as u16;
    let mut message = Vec::with_capacity(HEADER + body.len());
    message.extend(length(HEADER + body.len()).to_ne_bytes());
    message.extend(kind.to_ne_bytes());
    message.extend(flags.to_ne_bytes());
    message.extend([0; 8]); // Sequence number and port: one request a socket needs neither.
    message.extend(body);
    message
}

/// `linux/rtnetlink.h`.
const RTEXT_FILTER_SKIP_STATS: u32 = 1 << 3;

fn attribute(into: &mut Vec<u8>, kind: u16, value: &[u8]) {
    #[allow(clippy::cast_possible_truncation, reason = "values are at most 256 bytes long")]
    into.extend(((ATTRIBUTE + value.len()) as u16).to_ne_bytes());
    into.extend(kind.to_ne_bytes());
    into.extend(value);
    into.resize(into.len().next_multiple_of(4), 0);
}

fn length(bytes: usize) -> u32 {
    u32::try_from(bytes).unwrap_or(u32::MAX)
}

/// The messages in what one read returned. Ends at the first that is not whole.
pub(super) fn messages(mut bytes: &[u8]) -> impl Iterator<Item = LinkMessage> {
    std::iter::from_fn(move || {
        loop {
            let length = u32_at(bytes, 0)? as usize;
            let kind = u16_at(bytes, 4)?;
            let body = bytes.get(HEADER..length)?;
            bytes = bytes.get(length.next_multiple_of(4)..).unwrap_or_default();
            match i32::from(kind) {
                libc::NLMSG_DONE => return Some(LinkMessage::Done),
                libc::NLMSG_ERROR => {
                    let errno = u32_at(body, 0)?.cast_signed().wrapping_neg();
                    return Some(LinkMessage::Error(errno));
                }
                _ if kind == libc::RTM_NEWLINK => return Some(LinkMessage::Link(link(body)?)),
                _ => {}
            }
        }
    })
}

/// A `struct ifinfomsg` and its attributes.
fn link(body: &[u8]) -> Option<Link> {
    let mut link = Link {
        can: u16_at(body, 2)? == libc::ARPHRD_CAN,
        index: u32_at(body, 4)?,
        up: u32_at(body, 8)? & libc::IFF_UP.cast_unsigned() != 0,
        ..Link::default()
    };
    for (kind, value) in attributes(body.get(INFO..)?) {
        match kind {
            libc::IFLA_IFNAME => link.name = text(value),
            libc::IFLA_MTU => link.mtu = u32_at(value, 0).unwrap_or(0),
            libc::IFLA_LINKINFO => {
                let of_kind = |kind| attributes(value).find(|(known, _)| *known == kind);
                link.kind = of_kind(libc::IFLA_INFO_KIND).map(|(_, value)| text(value));
                let data = of_kind(libc::IFLA_INFO_DATA).map_or(&[][..], |(_, value)| value);
                if link.kind.as_deref() == Some("can") {
                    add_controller(&mut link, data);
                }
            }
            _ => {}
        }
    }
    Some(link)
}

/// What the attributes of `linux/can/netlink.h` say of a controller's state.
fn add_controller(link: &mut Link, data: &[u8]) {
    for (kind, value) in attributes(data) {
        match i32::from(kind) {
            libc::IFLA_CAN_STATE => link.state = u32_at(value, 0),
            // struct can_berr_counter: txerr, rxerr.
            libc::IFLA_CAN_BERR_COUNTER => link.errors = u16_at(value, 0).zip(u16_at(value, 2)),
            _ => {}
        }
    }
}

/// Type and value of each attribute. Ends at the first that is not whole.
fn attributes(mut bytes: &[u8]) -> impl Iterator<Item = (u16, &[u8])> {
    std::iter::from_fn(move || {
        let length = usize::from(u16_at(bytes, 0)?);
        let kind = u16_at(bytes, 2)? & TYPE_MASK;
        let value = bytes.get(ATTRIBUTE..length)?;
        bytes = bytes.get(length.next_multiple_of(4)..).unwrap_or_default();
        Some((kind, value))
    })
}

fn text(value: &[u8]) -> String {
    let end = value.iter().position(|byte| *byte == 0).unwrap_or(value.len());
    String::from_utf8_lossy(&value[..end]).into_owned()
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|chunk| u16::from_ne_bytes(*chunk))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|chunk| u32::from_ne_bytes(*chunk))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vcan() -> Vec<u8> {
        let mut body = vec![0, 0];
        body.extend(libc::ARPHRD_CAN.to_ne_bytes());
        body.extend(7u32.to_ne_bytes());
        body.extend(0x0001_00C1_u32.to_ne_bytes());
        body.extend([0; 4]);
        attribute(&mut body, libc::IFLA_IFNAME, b"plant\0");
        attribute(&mut body, libc::IFLA_MTU, &72u32.to_ne_bytes());
        let mut info = Vec::new();
        attribute(&mut info, libc::IFLA_INFO_KIND, b"vcan\0");
        attribute(&mut body, libc::IFLA_LINKINFO | 0x8000, &info);
        message(libc::RTM_NEWLINK, 0, &body)
    }

    #[test]
    fn a_link_message_tells_kind_and_state() {
        let mut bytes = vcan();
        bytes.extend(message(3, 0, &[]));
        let expected = Link {
            index: 7,
            name: "plant".into(),
            can: true,
            up: true,
            mtu: 72,
            kind: Some("vcan".into()),
            ..Link::default()
        };
        let found: Vec<_> = messages(&bytes).collect();
        assert_eq!(found, [LinkMessage::Link(expected), LinkMessage::Done]);
    }

    #[test]
    fn a_controller_tells_its_state_and_its_counters() {
        let mut data = Vec::new();
        attribute(&mut data, 1, &[0; 32]);
        attribute(&mut data, 4, &2u32.to_ne_bytes());
        attribute(&mut data, 8, &[130u16.to_ne_bytes(), 7u16.to_ne_bytes()].concat());
        let mut info = Vec::new();
        attribute(&mut info, libc::IFLA_INFO_KIND, b"can\0");
        attribute(&mut info, libc::IFLA_INFO_DATA, &data);
        let mut body = vec![0; INFO];
        attribute(&mut body, libc::IFLA_LINKINFO, &info);
        let bytes = message(libc::RTM_NEWLINK, 0, &body);
        let Some(LinkMessage::Link(link)) = messages(&bytes).next() else { panic!() };
        assert_eq!((link.state, link.errors), (Some(2), Some((130, 7))));
    }

    #[test]
    fn refusals_carry_the_error_number() {
        let bytes = message(2, 0, &(-libc::ENODEV).to_ne_bytes());
        assert_eq!(messages(&bytes).collect::<Vec<_>>(), [LinkMessage::Error(libc::ENODEV)]);
    }

    #[test]
    fn messages_cut_anywhere_or_with_wrong_lengths_end_the_list() {
        let whole = vcan();
        for end in 0..whole.len() {
            assert_eq!(messages(&whole[..end]).count(), 0, "{end}");
        }
        for at in 0..whole.len() {
            for byte in [0, 1, 3, 15, 0xFF] {
                let mut wrong = whole.clone();
                wrong[at] = byte;
                assert!(messages(&wrong).count() <= 1);
            }
        }
    }

    // As `ip link set can0 type can bitrate 500000 dbitrate 2000000 fd on` sends it.
    #[test]
    fn a_bit_rate_is_asked_for_as_ip_does() {
        let bytes = request_bitrate(7, 500_000, Some(2_000_000));
        assert_eq!(u32_at(&bytes, 0), Some(length(bytes.len())));
        let (kind, link) = attributes(&bytes[HEADER + INFO..]).next().unwrap();
        assert_eq!(kind, libc::IFLA_LINKINFO);
        let link: Vec<_> = attributes(link).collect();
        assert_eq!(link[0], (libc::IFLA_INFO_KIND, b"can\0".as_slice()));
        let settings: Vec<_> = attributes(link[1].1).collect();
        let kinds: Vec<_> = settings.iter().map(|(kind, value)| (*kind, value.len())).collect();
        assert_eq!(kinds, [(1, 32), (9, 32), (5, 8)]);
        assert_eq!(u32_at(settings[0].1, 0), Some(500_000));
        assert_eq!(u32_at(settings[1].1, 0), Some(2_000_000));
    }
}
