// What a first try in C++ takes: peaks of each row that rise and fall by a threshold, and the top of the least
// squares parabola through the logarithms around them, all weights 1 (log-parabola) or the square of the light
// (Guo's Gaussian). The background is the higher of the darkest pixels on both sides. Told the threshold; states
// no uncertainty, no width, no flags.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace {

// Natural logarithms of whole grey levels above the background; what is darker counts as half a level.
const std::array<double, 256> LOGARITHMS = [] {
    std::array<double, 256> made{};
    for (int level = 0; level < 256; ++level) made[level] = std::log(std::max<double>(level, 0.5));
    return made;
}();

double top(const uint8_t* row, int at, int base, int reach, bool weighted) {
    double s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, t0 = 0, t1 = 0, t2 = 0;
    for (int u = -reach; u <= reach; ++u) {
        const int level = row[at + u];
        const int above = std::max(level - base, 0);
        if (weighted && (level == 255 || above == 0)) continue;
        const double w = weighted ? double(above) * above : 1.0, y = LOGARITHMS[above], uu = double(u) * u;
        s0 += w, s1 += w * u, s2 += w * uu, s3 += w * uu * u, s4 += w * uu * uu;
        t0 += w * y, t1 += w * u * y, t2 += w * uu * y;
    }
    const double m11 = s2 * s0 - s1 * s1, m12 = s3 * s0 - s1 * s2, m22 = s4 * s0 - s2 * s2;
    const double d1 = t1 * s0 - s1 * t0, d2 = t2 * s0 - s2 * t0;
    const double c1 = d1 * m22 - d2 * m12, c2 = m11 * d2 - m12 * d1;
    return c2 < 0 ? std::clamp(-0.5 * c1 / c2, -double(reach), double(reach)) : 0.0;
}

}  // namespace

extern "C" int64_t peaks(const uint8_t* image, int64_t rows, int64_t columns, int threshold, int reach, int weighted,
                         int64_t room, double* row_out, double* x_out) {
    int64_t count = 0;
    for (int64_t y = 0; y < rows; ++y) {
        const uint8_t* row = image + y * columns;
        int x = 0;
        while (x < columns) {
            int low = row[x];
            while (x < columns && row[x] - low <= threshold) low = std::min<int>(low, row[x++]);
            int first = x, high = x < columns ? row[x] : 0, last = x;
            while (x < columns && high - row[x] <= threshold) {
                if (row[x] > high) high = row[x], first = x;
                if (row[x] == high) last = x;
                ++x;
            }
            if (x >= columns) break;
            const int at = (first + last) / 2;
            if (at < reach || at + reach >= columns || count == room) continue;
            int after = row[x];
            for (int k = x; k < std::min<int>(x + 16, columns); ++k) after = std::min<int>(after, row[k]);
            row_out[count] = y;
            x_out[count++] = at + top(row, at, std::max(low, after), reach, weighted);
        }
    }
    return count;
}
