// The display's 8-bit codes of every radiance in [0, 2] (rule 19), by each transfer, against thresholds taken from the
// transfers' formulas in long double.
#include "render/display.h"
#include "verify/exhaustive_host.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

namespace rt {
namespace {

// As many pixels as to_8bit() goes over by edges, as in an image; the last piece of a chunk is smaller and goes over by
// sums.
constexpr std::uint64_t display_piece = 3u << 15;
constexpr Transfer transfers[] = {Transfer::Srgb, Transfer::Gamma2, Transfer::Linear};

// The radiance that is encoded to `code`.
long double decode(long double code, Transfer transfer)
{
	if (transfer == Transfer::Gamma2)
		return code * code;
	if (transfer == Transfer::Srgb)
		return code <= 0.04045L ? code / 12.92L : std::pow((code + 0.055L) / 1.055L, 2.4L);
	return code;
}

// The smallest film integer, in 2^-40, whose code is k + 1, for k = 0 to 254.
std::array<std::int64_t, 255> edges_of(Transfer transfer)
{
	std::array<std::int64_t, 255> edges{};
	for (int k = 0; k < 255; ++k)
		edges[static_cast<std::size_t>(k)] =
		    static_cast<std::int64_t>(std::ceil(decode((2 * k + 1) / 510.0L, transfer) * 0x1p40L));
	return edges;
}

} // namespace

void advance_display(ExhaustiveResult& result)
{
	static const std::array<std::array<std::int64_t, 255>, 3> edges = {
	    edges_of(Transfer::Srgb), edges_of(Transfer::Gamma2), edges_of(Transfer::Linear)};
	advance_on_host(result, display_piece, [&result](std::uint64_t begin, std::uint64_t end) {
		// A film of three inputs a pixel; of the last pixel some may be nobody's.
		const auto pixels = static_cast<std::uint32_t>((end - begin + 2) / 3);
		Film film(pixels, 1, Window{0, 0, pixels, 1}, 40);
		for (std::uint64_t i = begin; i < end; ++i) {
			const auto bits = static_cast<std::uint32_t>((result.done + i) * result.stride);
			float radiance;
			std::memcpy(&radiance, &bits, sizeof radiance);
			film.sums()[i - begin] = std::llrint(static_cast<double>(radiance) * 0x1p40);
		}
		std::fill(film.samples().begin(), film.samples().end(), 1u);
		HostFindings found;
		for (std::size_t t = 0; t < 3; ++t) {
			const std::vector<std::uint8_t> codes = to_8bit(film, {transfers[t], 0});
			for (std::size_t i = 0; i < end - begin; ++i) {
				const auto want = std::upper_bound(edges[t].begin(), edges[t].end(), film.sums()[i]) - edges[t].begin();
				if (codes[i] != want && found.wrong++ == 0)
					found.first_failure = fmt::format("{} of {} 2^-40 gave {}, the formula says {}",
					                                  transfer_name(transfers[t]), film.sums()[i], codes[i], want);
			}
		}
		return found;
	});
}

} // namespace rt
