//! What can only be read from the slave.
//!
//! Names, types and order are those of the "Zhongheng 09-series RS232 protocol", section 8. The
//! document gives neither scales nor units for most fields; voltages are V,
//! currents A, powers W, temperatures °C.

use super::layout::Value::{Is, Live, Names};
use super::layout::{Command, array, bytes, f32, read, read_records, text, u8, u16, u32};
use super::plant::Plant;
use super::rectifier::Rectifier;

/// The commands that can only be read.
#[rustfmt::skip]
pub const READINGS: &[Command] = &[
    read(0x0000, "slave_type", &[
        u8("monitor_type", Is(19.0)),
    ]),
    read(0x0001, "software_version", &[
        u32("software_version", Is(10403.0)),
    ]),
    read(0x0002, "hardware_version", &[
        u32("hardware_version", Is(201.0)),
    ]),
    read(0x019a, "real_time", &[
        u32("real_time", Live(|p, _| p.unix_time())),
    ]),
    read_records(0x01a9, "cell_voltages", 24, &[
        f32("cell_voltage", Live(Plant::cell_voltage)),
    ]),
    read(0x407e, "system_analogs", &[
        f32("ac_voltage", Live(|p, _| (p.phase(0) + p.phase(1) + p.phase(2)) / 3.0)),
        f32("phase_a_voltage", Live(|p, _| p.phase(0))),
        f32("phase_b_voltage", Live(|p, _| p.phase(1))),
        f32("phase_c_voltage", Live(|p, _| p.phase(2))),
        f32("bus_voltage", Live(|p, _| p.bus_voltage())),
        f32("load_current", Live(|p, _| p.load_current())),
        f32("battery_total_current", Live(|p, _| p.battery().current())),
        f32("rectifier_total_current", Live(|p, _| p.rectifier_current())),
        f32("power_percent", Live(|p, _| p.power_percent())),
        f32("system_power", Live(|p, _| p.bus_voltage() * p.load_current())),
        f32("battery_temperature", Live(|p, _| p.battery().temperature())),
        f32("ambient_temperature", Live(|p, _| p.ambient())),
    ]),
    read(0x409c, "operating_voltage", &[
        f32("set_operating_voltage", Live(|p, _| p.float_voltage())),
        f32("target_voltage", Live(|p, _| p.target_voltage())),
        f32("voltage_sent_to_rectifiers", Live(|p, _| p.target_voltage())),
        f32("rectifier_total_current", Live(|p, _| p.rectifier_current())),
        f32("rectifier_total_power", Live(|p, _| p.rectifier_power())),
        f32("reserved", Is(0.0)),
    ]),
    read(0x40b0, "control_process", &[
        u8("temp_comp_status", Is(1.0)),
        f32("temp_comp_offset_voltage", Live(|p, _| p.temperature_offset())),
        u8("battery_test_status", Is(0.0)),
        u32("discharge_test_remaining_time", Is(0.0)),
        u32("discharge_period_time", Live(|p, _| p.minutes_until(180.0 * 1440.0))),
        u8("discharge_test_start_status", Is(0.0)),
        u32("discharge_test_lockout_time", Is(0.0)),
        f32("discharge_test_offset_voltage", Is(0.0)),
        u8("equalize_status", Live(|p, _| f64::from(u8::from(p.equalizing())))),
        u32("equalize_remaining_time", Is(0.0)),
        u32("equalize_period_time", Live(|p, _| p.minutes_until(90.0 * 1440.0))),
        u8("equalize_start_allowed", Is(1.0)),
        f32("equalize_offset_voltage", Live(|p, _| p.equalize_offset())),
        u8("equalize_status_2", Live(|p, _| f64::from(u8::from(p.equalizing())))),
        u32("equalize_countdown_time", Live(|p, _| (p.minutes_until(90.0 * 1440.0) / 60.0).floor())),
        f32("fast_charge_offset_voltage", Is(0.0)),
        f32("reserved_1", Is(0.0)),
        u8("battery_current_limit_status", Live(|p, _| f64::from(u8::from(p.limits_battery_current())))),
        u32("reserved_2", Is(0.0)),
        u8("generator_current_limit_status", Is(0.0)),
        f32("current_limit_offset_voltage", Live(|p, _| p.limit_offset())),
        u8("active_voltage_control_status", Is(1.0)),
        f32("active_voltage_control_offset_voltage", Is(0.0)),
        u8("lvd1_status", Is(0.0)),
        u16("reserved_3", Is(0.0)),
        u8("lvd1_fault_status", Is(0.0)),
        u8("lvd2_status", Is(0.0)),
        u16("reserved_4", Is(0.0)),
        u8("lvd2_fault_status", Is(0.0)),
        u8("rectifier_connected_count", Live(|p, _| p.count_working() as f64)),
        u32("sleep_test_remaining_time", Is(0.0)),
        u32("sleep_pause_remaining_time", Is(0.0)),
        u8("sleep_status", Is(0.0)),
        bytes("reserved_5", 20, Is(0.0)),
    ]),
    read(0x40e2, "rectifier_registration_state", &[
        array("rectifier_registration_state", 40, Live(Plant::registration)),
    ]),
    read(0x40ec, "rectifier_data", &[
        f32("output_voltage", Live(Plant::output_voltage)),
        f32("output_current", Live(|p, i| p.rectifier(i).map_or(0.0, Rectifier::current))),
        u8("heatsink_temperature", Live(|p, i| p.rectifier(i).map_or(0.0, |r| r.temperature().round()))),
        f32("power_percent", Live(|p, i| p.rectifier(i).map_or(0.0, |r| r.current() / 50.0 * 100.0))),
        u8("registration_state", Live(Plant::registration)),
        u32("serial_number", Live(|p, i| p.rectifier(i).map_or(0.0, |r| f64::from(r.serial())))),
        u8("on_off_state", Live(|p, i| p.rectifier(i).map_or(0.0, |r| if r.on() { 0.0 } else { 255.0 }))),
        u8("max_input_current", Live(|p, i| p.rectifier(i).map_or(0.0, |_| 20.0))),
        f32("max_current_limit", Live(|p, i| p.rectifier(i).map_or(0.0, |_| 55.0))),
        u16("max_power_limit", Live(|p, i| p.rectifier(i).map_or(0.0, |_| 3000.0))),
        f32("average_power_voltage", Live(Plant::output_voltage)),
        u32("fault_flags", Live(|p, i| p.rectifier(i).map_or(0.0, |r| f64::from(r.faults())))),
        u32("run_time", Live(|p, i| p.rectifier(i).map_or(0.0, Rectifier::run_seconds))),
    ]),
    read_records(0x40ed, "rxp_row", 4, &[
        u8("rxp_slave_type", Is(33.0)),
        u32("serial_number", Live(|p, i| f64::from(p.rectifier(i).map_or(0, Rectifier::serial)))),
        u8("registration_state", Live(Plant::registration)),
        text("module_name", 16, Names(&["ZHR4850", "ZHR4850", "ZHR4850", "ZHR4850"])),
        text("hardware_version", 16, Names(&["A1.2", "A1.2", "A1.2", "A1.3"])),
        text("software_version", 16, Names(&["V2.07", "V2.07", "V2.07", "V2.09"])),
    ]),
    read(0x40ee, "rectifier_average_power", &[
        f32("average_power", Live(|p, _| p.average_power())),
        f32("reserved", Is(0.0)),
    ]),
    read(0x40ef, "summary_alarm_states", &[
        u8("reserved_1", Is(0.0)),
        u8("reserved_2", Is(0.0)),
        u8("reserved_3", Is(0.0)),
        u8("alarm_state", Live(|p, _| f64::from(u8::from(p.alarms().any())))),
    ]),
    read(0x40f0, "event_log_numbers", &[
        u32("event_log_first_index", Live(|p, _| f64::from(p.alarms().log().0))),
        u32("event_log_last_index", Live(|p, _| f64::from(p.alarms().log().1))),
        u32("reserved", Is(0.0)),
    ]),
    read(0x414b, "warn_infor", &[
        array("alarm", 80, Live(|p, i| f64::from(p.alarms().code(i)))),
    ]),
];
