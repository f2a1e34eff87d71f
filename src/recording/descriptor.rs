//! Message types of a schema that somebody else has written.

use prost::Message as _;
use prost_reflect::DescriptorPool;
use prost_reflect::prost_types::FileDescriptorSet;

/// The types in an encoded `google.protobuf.FileDescriptorSet` (descriptor.proto); `None` where it is none, or
/// one of a syntax that nobody knows.
///
/// Files with `edition = "2023"` and later are read as proto3, which has the same encoding; only whether a field
/// that is zero is there cannot be told of them.
pub fn types(data: &[u8]) -> Option<DescriptorPool> {
    let mut set = FileDescriptorSet::decode(data).ok()?;
    for file in &mut set.file {
        match file.syntax.as_deref() {
            None | Some("proto2" | "proto3") => {}
            Some("editions") => file.syntax = Some("proto3".to_owned()),
            // The library panics while it words the error (prost-reflect 0.16, `Label::new`).
            Some(_) => return None,
        }
    }
    let mut pool = DescriptorPool::new();
    pool.add_file_descriptor_set(set).ok()?;
    Some(pool)
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost_reflect::prost_types::{DescriptorProto, FileDescriptorProto};

    fn set(syntax: Option<&str>) -> Vec<u8> {
        let message = DescriptorProto { name: Some("M".to_owned()), ..DescriptorProto::default() };
        let file = FileDescriptorProto {
            name: Some("m.proto".to_owned()),
            syntax: syntax.map(str::to_owned),
            message_type: vec![message],
            ..FileDescriptorProto::default()
        };
        FileDescriptorSet { file: vec![file] }.encode_to_vec()
    }

    #[test]
    fn types_of_every_syntax_are_read_and_those_of_none_are_no_fault() {
        for known in [None, Some("proto2"), Some("proto3"), Some("editions")] {
            let pool = types(&set(known));
            assert!(pool.is_some_and(|pool| pool.get_message_by_name("M").is_some()), "{known:?}");
        }
        for other in ["", "prot\u{f3}3"] {
            assert!(types(&set(Some(other))).is_none(), "{other}");
        }
        assert!(types(b"\xFF\xFF").is_none());
    }
}
