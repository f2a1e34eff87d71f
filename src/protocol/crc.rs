//! Frame checks by their names in the CRC catalogue (<https://reveng.sourceforge.io/crc-catalogue>),
//! and the three sums that small devices use instead.

use crc::Crc;

/// A checksum of up to 64 bits.
#[derive(Clone)]
pub struct Checksum {
    /// Width in bits, 3 to 64.
    pub width: u32,
    engine: Engine,
}

#[derive(Clone)]
enum Engine {
    W8(Box<Crc<u8>>),
    W16(Box<Crc<u16>>),
    W32(Box<Crc<u32>>),
    W64(Box<Crc<u64>>),
    Sum8,
    Xor8,
    Lrc8,
}

impl std::fmt::Debug for Checksum {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Checksum({} bits)", self.width)
    }
}

impl Checksum {
    /// Finds `CRC_16_XMODEM`, also written `CRC-16/XMODEM`.
    pub fn by_name(name: &str) -> Option<Self> {
        let key: String = name
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' })
            .collect();
        let (width, engine) = match key.as_str() {
            "SUM_8" => (8, Engine::Sum8),
            "XOR_8" => (8, Engine::Xor8),
            "LRC_8" => (8, Engine::Lrc8),
            key => by_catalogue_name(key)?,
        };
        Some(Self { width, engine })
    }

    /// Bytes that carry it in a frame, 1 to 8.
    pub fn bytes(&self) -> usize {
        self.width.div_ceil(8) as usize
    }

    /// The checksum of `bytes`.
    pub fn of(&self, bytes: &[u8]) -> u64 {
        let sum = || bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
        match &self.engine {
            Engine::W8(crc) => crc.checksum(bytes).into(),
            Engine::W16(crc) => crc.checksum(bytes).into(),
            Engine::W32(crc) => crc.checksum(bytes).into(),
            Engine::W64(crc) => crc.checksum(bytes),
            Engine::Sum8 => sum().into(),
            Engine::Lrc8 => sum().wrapping_neg().into(),
            Engine::Xor8 => bytes.iter().fold(0, |sum, byte| sum ^ u64::from(*byte)),
        }
    }
}

/// Writes the table of the catalogue: names by the width of the register.
macro_rules! catalogue {
    ($($engine:ident $register:ty: $($name:ident)*;)*) => {
        fn by_catalogue_name(key: &str) -> Option<(u32, Engine)> {
            Some(match key {
                $($(stringify!($name) => (
                    u32::from(crc::$name.width),
                    Engine::$engine(Box::new(Crc::<$register>::new(&crc::$name))),
                ),)*)*
                _ => return None,
            })
        }

        /// Every CRC that can be named.
        pub const NAMES: &[&str] = &[$($(stringify!($name),)*)* "SUM_8", "XOR_8", "LRC_8"];
    };
}

catalogue! {
    W8 u8:
        CRC_3_GSM CRC_3_ROHC CRC_4_G_704 CRC_4_INTERLAKEN CRC_5_EPC_C1G2 CRC_5_G_704 CRC_5_USB
        CRC_6_CDMA2000_A CRC_6_CDMA2000_B CRC_6_DARC CRC_6_G_704 CRC_6_GSM CRC_7_MMC CRC_7_ROHC
        CRC_7_UMTS CRC_8_AUTOSAR CRC_8_BLUETOOTH CRC_8_CDMA2000 CRC_8_DARC CRC_8_DVB_S2
        CRC_8_GSM_A CRC_8_GSM_B CRC_8_HITAG CRC_8_I_432_1 CRC_8_I_CODE CRC_8_LTE CRC_8_MAXIM_DOW
        CRC_8_MIFARE_MAD CRC_8_NRSC_5 CRC_8_OPENSAFETY CRC_8_ROHC CRC_8_SAE_J1850 CRC_8_SMBUS
        CRC_8_TECH_3250 CRC_8_WCDMA;
    W16 u16:
        CRC_10_ATM CRC_10_CDMA2000 CRC_10_GSM CRC_11_FLEXRAY CRC_11_UMTS CRC_12_CDMA2000
        CRC_12_DECT CRC_12_GSM CRC_12_UMTS CRC_13_BBC CRC_14_DARC CRC_14_GSM CRC_15_CAN
        CRC_15_MPT1327 CRC_16_ARC CRC_16_CDMA2000 CRC_16_CMS CRC_16_DDS_110 CRC_16_DECT_R
        CRC_16_DECT_X CRC_16_DNP CRC_16_EN_13757 CRC_16_GENIBUS CRC_16_GSM CRC_16_IBM_3740
        CRC_16_IBM_SDLC CRC_16_ISO_IEC_14443_3_A CRC_16_KERMIT CRC_16_LJ1200 CRC_16_M17
        CRC_16_MAXIM_DOW CRC_16_MCRF4XX CRC_16_MODBUS CRC_16_NRSC_5 CRC_16_OPENSAFETY_A
        CRC_16_OPENSAFETY_B CRC_16_PROFIBUS CRC_16_RIELLO CRC_16_SPI_FUJITSU CRC_16_T10_DIF
        CRC_16_TELEDISK CRC_16_TMS37157 CRC_16_UMTS CRC_16_USB CRC_16_XMODEM;
    W32 u32:
        CRC_17_CAN_FD CRC_21_CAN_FD CRC_24_BLE CRC_24_FLEXRAY_A CRC_24_FLEXRAY_B
        CRC_24_INTERLAKEN CRC_24_LTE_A CRC_24_LTE_B CRC_24_OPENPGP CRC_24_OS_9 CRC_30_CDMA
        CRC_31_PHILIPS CRC_32_AIXM CRC_32_AUTOSAR CRC_32_BASE91_D CRC_32_BZIP2 CRC_32_CD_ROM_EDC
        CRC_32_CKSUM CRC_32_ISCSI CRC_32_ISO_HDLC CRC_32_JAMCRC CRC_32_MEF CRC_32_MPEG_2
        CRC_32_XFER;
    W64 u64:
        CRC_40_GSM CRC_64_ECMA_182 CRC_64_GO_ISO CRC_64_MS CRC_64_NVME CRC_64_REDIS CRC_64_WE
        CRC_64_XZ;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_found_and_gives_its_catalogue_check() {
        for name in NAMES {
            let sum = Checksum::by_name(name).unwrap();
            assert!((1..=8).contains(&sum.bytes()), "{name}");
        }
        let check = |name: &str| Checksum::by_name(name).unwrap().of(b"123456789");
        assert_eq!(check("CRC_16_XMODEM"), 0x31C3);
        assert_eq!(check("crc-16/modbus"), 0x4B37);
        assert_eq!(check("CRC-8/SMBUS"), 0xF4);
        assert_eq!(check("CRC_32_ISO_HDLC"), 0xCBF4_3926);
        assert_eq!(check("CRC_64_XZ"), 0x995D_C9BB_DF19_39FA);
        assert_eq!((check("SUM_8"), check("LRC_8"), check("XOR_8")), (0xDD, 0x23, 0x31));
        assert!(Checksum::by_name("CRC_16_NOBODY").is_none());
    }
}
