// flip.h: the FLIP difference of two pictures, from 0 (none is seen) to 1 (black against white is less).
//
// Andersson, Nilsson, Akenine-Moller, Oskarsson, Astrom, Fairchild: "FLIP: A Difference Evaluator for Alternating
// Images", HPG 2020 (LDR-FLIP); the same and others: "Visualizing Errors in Rendered High Dynamic Range Images",
// Eurographics 2021 (HDR-FLIP). Tested against the authors' program flip-evaluator.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace rt {

// A picture as a viewer gets it: linear Rec. 709 R, G, B a pixel, rows from the top. LDR-FLIP cuts it to [0, 1].
struct FlipPicture {
	std::uint32_t width = 0, height = 0;
	std::vector<float> rgb;
};

// Pixels a degree of the visual field: the papers' 0.7 m from a screen that is 0.7 m and 3840 pixels wide.
extern const double flip_pixels_per_degree;

// The error of each pixel. Both pictures have the same size. Numbers that are not finite count as 0.
std::vector<float> flip_map(const FlipPicture& reference, const FlipPicture& test,
                            double pixels_per_degree = flip_pixels_per_degree);

// The largest error over a series of exposures that the reference chooses, each shown through the ACES curve.
struct HdrFlip {
	std::vector<float> map;
	double first_exposure = 0, last_exposure = 0; // stops
	unsigned exposures = 0;
};
HdrFlip hdr_flip_map(const FlipPicture& reference, const FlipPicture& test,
                     double pixels_per_degree = flip_pixels_per_degree);

double mean_of(const std::vector<float>& map);

} // namespace rt
