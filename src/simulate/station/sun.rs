//! Where the sun stands, and how much of it would arrive under a clear sky.
//!
//! Declination and equation of time by the usual short formulas: within about half a degree,
//! which no panel notices.

/// A place on the Earth.
#[derive(Clone, Copy, Debug)]
pub struct Site {
    /// Degrees north, -90..=90.
    pub latitude: f64,
    /// Degrees east, -180..=180.
    pub longitude: f64,
    /// Hours ahead of UTC.
    pub timezone: f64,
}

/// The sun of one day.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Day {
    /// Local time of sunrise, decimal hours.
    pub sunrise: f64,
    /// Local time of sunset, decimal hours.
    pub sunset: f64,
    /// Local time when the sun stands in the south, decimal hours.
    noon: f64,
    declination: f64,
}

/// Where the sun stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// Degrees above the horizon, negative below.
    pub elevation: f64,
    /// Degrees from north over east, 0..360.
    pub azimuth: f64,
}

/// The sun over `site` on day `day_of_year` (1..=366).
pub fn day(site: Site, day_of_year: f64) -> Day {
    let year = std::f64::consts::TAU / 365.25;
    let declination = -23.44 * ((day_of_year + 10.0) * year).cos();
    let b = (day_of_year - 81.0) * year;
    let equation_of_time = (9.87 * (2.0 * b).sin() - 7.53 * b.cos() - 1.5 * b.sin()) / 60.0;
    let noon = 12.0 + site.timezone - site.longitude / 15.0 - equation_of_time;
    // The sun counts as risen when its upper edge shows, refraction included: -0.833 degrees.
    let cos = ((-0.833_f64).to_radians().sin()
        - site.latitude.to_radians().sin() * declination.to_radians().sin())
        / (site.latitude.to_radians().cos() * declination.to_radians().cos());
    let half = cos.clamp(-1.0, 1.0).acos().to_degrees() / 15.0;
    Day { sunrise: noon - half, sunset: noon + half, noon, declination }
}

impl Day {
    /// From sunrise to sunset, decimal hours.
    pub fn duration(&self) -> f64 {
        self.sunset - self.sunrise
    }

    /// Where the sun stands over `site` at local time `hour` (decimal hours, 0..24).
    pub fn position(&self, site: Site, hour: f64) -> Position {
        let angle = ((hour - self.noon) * 15.0).to_radians();
        let (latitude, declination) = (site.latitude.to_radians(), self.declination.to_radians());
        let sin =
            latitude.sin() * declination.sin() + latitude.cos() * declination.cos() * angle.cos();
        let from_south = angle
            .sin()
            .atan2(angle.cos() * latitude.sin() - declination.tan() * latitude.cos())
            .to_degrees();
        let elevation = sin.clamp(-1.0, 1.0).asin().to_degrees();
        Position { elevation, azimuth: (180.0 + from_south).rem_euclid(360.0) }
    }
}

/// Direct irradiance on a surface facing the sun under a clear sky, W/m² (Meinel's formula with
/// the air mass of Kasten and Young).
pub fn clear_beam(elevation: f64) -> f64 {
    if elevation <= 0.0 {
        return 0.0;
    }
    let sin = elevation.to_radians().sin();
    let air_mass = 1.0 / (sin + 0.505_72 * (elevation + 6.079_95).powf(-1.6364));
    // Hills and haze take the lowest few degrees.
    let horizon = (elevation / 4.0).min(1.0).powi(2);
    1353.0 * 0.7_f64.powf(air_mass.powf(0.678)) * horizon
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROSTOV: Site = Site { latitude: 47.24, longitude: 39.71, timezone: 3.0 };

    #[test]
    fn sunrise_and_sunset_agree_with_the_noaa_algorithm() {
        // Rostov-on-Don in 2024, by the full NOAA algorithm.
        for (date, sunrise, sunset) in
            [(106.0, 5.534, 19.169), (308.0, 7.133, 17.022), (356.0, 8.087, 16.560)]
        {
            let day = day(ROSTOV, date);
            assert!((day.sunrise - sunrise).abs() < 0.1, "{day:?}");
            assert!((day.sunset - sunset).abs() < 0.1, "{day:?}");
        }
    }

    #[test]
    fn the_sun_rises_in_the_east_and_sets_in_the_west() {
        let equinox = day(ROSTOV, 80.0);
        let rise = equinox.position(ROSTOV, equinox.sunrise);
        assert!((rise.azimuth - 89.0).abs() < 2.0 && (rise.elevation + 0.833).abs() < 0.1);
        let noon = equinox.position(ROSTOV, equinox.noon);
        assert!((noon.azimuth - 180.0).abs() < 0.1);
        assert!((noon.elevation - (90.0 - 47.24)).abs() < 1.0, "{noon:?}");
        let set = equinox.position(ROSTOV, equinox.sunset);
        assert!((set.azimuth - 271.0).abs() < 2.0, "{set:?}");
    }

    #[test]
    fn a_clear_noon_gives_about_900_watts() {
        assert!((850.0..1000.0).contains(&clear_beam(60.0)), "{}", clear_beam(60.0));
        assert_eq!(clear_beam(-1.0), 0.0);
    }
}
