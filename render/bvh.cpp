#include "render/bvh.h"

#include "common/rt_features.h"
#include "render/lights.h"
#include "support/pages.h"
#include "support/thread_pool.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstring>
#include <fmt/format.h>
#include <limits>
#include <mutex>
#include <new>

namespace rt {
namespace {

using Axis = std::size_t;

// A sphere on its way through the build: centre relative to the tree's, radius, and where it was stored.
struct Item {
	std::array<float, 3> center;
	float radius;
	std::uint32_t source;
};

// Three axes and a fourth number that nobody reads: so compilers take a corner as one vector.
struct Box {
	alignas(16) std::array<float, 4> low{HUGE_VALF, HUGE_VALF, HUGE_VALF, HUGE_VALF};
	alignas(16) std::array<float, 4> high{-HUGE_VALF, -HUGE_VALF, -HUGE_VALF, -HUGE_VALF};

	void add(const std::array<float, 3>& point, float radius = 0)
	{
		const std::array<float, 4> center = {point[0], point[1], point[2], 0};
		for (Axis a = 0; a < 4; ++a) {
			low[a] = std::min(low[a], center[a] - radius);
			high[a] = std::max(high[a], center[a] + radius);
		}
	}
	void add(const Item& item) { add(item.center, item.radius); }
	void add(const Box& other)
	{
		for (Axis a = 0; a < 4; ++a) {
			low[a] = std::min(low[a], other.low[a]);
			high[a] = std::max(high[a], other.high[a]);
		}
	}
	// Half the surface area; 0 where the box is empty. Its products are exact, as are those of an area and a small
	// number: in double a compiler may fuse them with sums or not, and std::fma is a call on many a machine.
	double half_area() const
	{
		const auto x = double(high[0] - low[0]), y = double(high[1] - low[1]), z = double(high[2] - low[2]);
		return x >= 0 ? double(static_cast<float>(x * y + y * z + z * x)) : 0.0;
	}
};

// Centres are sorted into this many slabs along each axis to choose where to cut (Wald 2007, "On fast Construction of
// SAH-based Bounding Volume Hierarchies").
constexpr std::size_t bin_count = 16;
// Below this binary depth a range is halved by the middle of its longest axis instead, which bounds the walk's stack
// whatever the scene is.
constexpr std::uint32_t sah_depth = 32;
// Ranges of more items than this are cut by one thread before the rest is shared out.
constexpr std::size_t min_parallel_items = 4096;
// Spheres of a leaf that one lane tests in turn, at most, and what visiting a node costs it in such tests; as measured
// on a GPU (docs/performance.md, Steps).
constexpr std::uint32_t max_leaf_in_turn = 8;
constexpr double node_cost_in_turn = 3;

struct Range {
	std::size_t begin = 0, end = 0;
	Box box;
	std::uint32_t depth = 0; // of binary cuts
	std::size_t size() const { return end - begin; }
};

// A part of a range that one thread cuts: what goes left comes to lie before its middle.
struct Piece {
	std::size_t begin = 0, middle = 0, end = 0;
};

struct Bin {
	Box box;
	std::size_t count = 0;

	void add(const Bin& other)
	{
		box.add(other.box);
		count += other.count;
	}
};

struct Cut {
	Axis axis = 0;
	std::size_t bin = 0; // items of the bins up to this one go left
	float low = 0, scale = 0;
	bool found = false;
	double cost = 0; // of both sides, in areas times tests
	Box left, right;
};

std::size_t bin_of(float center, float low, float scale)
{
	return std::min(static_cast<std::size_t>((center - low) * scale), bin_count - 1);
}

struct Shape {
	std::uint32_t width = 4; // children of a node
	std::uint32_t leaf = 4;  // spheres of a leaf, at most
	double node_cost = 1;    // of a visit, in tests
	bool blocks = false;     // spheres of a leaf cost one test together

	double cost(std::size_t spheres) const
	{
		const std::size_t tests = blocks ? (spheres + leaf - 1) / leaf : spheres;
		return static_cast<double>(tests);
	}
};

// Bins along all three axes.
struct Bins {
	std::array<std::array<Bin, bin_count>, 3> bins;
	void add(const Bins& other)
	{
		for (Axis a = 0; a < 3; ++a)
			for (std::size_t b = 0; b < bin_count; ++b)
				bins[a][b].add(other.bins[a][b]);
	}
};

// add(sum, index) for each number of [begin, end) by all threads, and their sums added up. Merging must be exact: then
// it does not matter who took what.
template <class Sum, class Add>
Sum merged_by_all(std::size_t begin, std::size_t end, const Add& add)
{
	Sum all;
	std::mutex mutex;
	parallel_for(end - begin, min_parallel_items, [&](std::uint64_t first, std::uint64_t last) {
		Sum sum;
		for (std::uint64_t i = first; i < last; ++i)
			add(sum, begin + i);
		const std::lock_guard<std::mutex> lock(mutex);
		all.add(sum);
	});
	return all;
}

// The middle of the box of all centres: so small scenes far from the camera keep their digits.
std::array<float, 3> center_of(const PackedScene& packed)
{
	const Box box = merged_by_all<Box>(packed.wide.size(), packed.spheres.size(), [&](Box& sum, std::size_t i) {
		const rt_sphere& sphere = packed.spheres[i];
		sum.add(std::array<float, 3>{sphere.cx, sphere.cy, sphere.cz});
	});
	std::array<float, 3> center{};
	for (Axis a = 0; a < 3; ++a)
		center[a] = static_cast<float>((double(box.low[a]) + double(box.high[a])) / 2);
	return center;
}

struct Extent {
	float value = 0;
	void add(const Extent& other) { value = std::max(value, other.value); }
};

// *extent: how far from the centre along an axis they reach.
std::vector<Item> items_of(const PackedScene& packed, const std::array<float, 3>& center, float* extent)
{
	const std::size_t wide = packed.wide.size();
	std::vector<Item> items;
	reserve_pages(items, packed.spheres.size() - wide);
	items.resize(packed.spheres.size() - wide);
	const Extent all = merged_by_all<Extent>(0, items.size(), [&](Extent& sum, std::size_t i) {
		const rt_sphere& s = packed.spheres[wide + i];
		items[i] = {
		    {s.cx - center[0], s.cy - center[1], s.cz - center[2]}, s.radius, static_cast<std::uint32_t>(wide + i)};
		for (const float c : items[i].center)
			sum.value = std::max(sum.value, std::fabs(c) + s.radius);
	});
	*extent = all.value;
	return items;
}

// A part of the tree, in the rows of common/rt_structs.h. Links to nodes and blocks count from the part's own first.
struct Part {
	std::vector<rt_row4> nodes, blocks;
	std::uint32_t stack = 0; // of a walk through it
	double area = 0;         // of the whole tree's box
	double visited_area = 0, tested_area = 0;
};

float from_bits(std::uint32_t bits)
{
	float value = 0;
	std::memcpy(&value, &bits, sizeof value);
	return value;
}

std::uint32_t to_bits(float value)
{
	std::uint32_t bits = 0;
	std::memcpy(&bits, &value, sizeof bits);
	return bits;
}

// A row of a vector of floats that spans several.
float& element(std::vector<rt_row4>& rows, std::size_t first_row, std::size_t index)
{
	rt_row4& row = rows[first_row + index / 4];
	switch (index % 4) {
	case 0:
		return row.a;
	case 1:
		return row.b;
	case 2:
		return row.c;
	default:
		return row.d;
	}
}

// Copies the spheres into their blocks, side by side.
void fill_blocks(Part& tree, const PackedScene& packed, std::size_t width)
{
	const std::size_t rows = RT_BVH_BLOCK_ROWS(width), vector_rows = width / 4;
	const auto fill = [&](std::size_t row) {
		const std::uint32_t first = to_bits(tree.blocks[row].a), count = to_bits(tree.blocks[row].b);
		for (std::size_t k = 0; k < width; ++k) {
			rt_sphere sphere{0, 0, 0, std::numeric_limits<float>::quiet_NaN()};
			if (k < count)
				sphere = packed.spheres[first + k];
			element(tree.blocks, row + 1, k) = sphere.cx;
			element(tree.blocks, row + 1 + vector_rows, k) = sphere.cy;
			element(tree.blocks, row + 1 + 2 * vector_rows, k) = sphere.cz;
			element(tree.blocks, row + 1 + 3 * vector_rows, k) = sphere.radius;
		}
	};
	parallel_for(tree.blocks.size() / rows, min_parallel_items / width, [&](std::uint64_t begin, std::uint64_t end) {
		for (std::uint64_t block = begin; block < end; ++block)
			fill(block * rows);
	});
}

class Builder {
public:
	// first_stored: storage index of the tree's first sphere.
	// max_sah_depth: binary cuts by the heuristic, on the way from the root; those below halve.
	Builder(std::vector<Item>& items, Shape shape, std::uint32_t first_stored, std::uint32_t max_sah_depth)
	    : items_(items), shape_(shape), first_stored_(first_stored), sah_depth_(max_sah_depth),
	      shared_size_(items.size() / 64)
	{
		shared_size_ = std::max(shared_size_, min_parallel_items);
	}

	// The whole tree; *root is a link to it. Leaves out nothing: every item is in one leaf.
	Part build(std::uint32_t* root)
	{
		const Range all{0, items_.size(), box_of(0, items_.size()), 0};
		Part top;
		top.area = all.box.half_area();
		std::vector<Range> deferred;
		*root = add(top, all, &deferred);
		std::vector<Part> parts(deferred.size());
		std::vector<std::uint32_t> roots(deferred.size());
		parallel_for(deferred.size(), 1, [&](std::uint64_t begin, std::uint64_t end) {
			for (std::uint64_t i = begin; i < end; ++i) {
				roots[i] = add(parts[i], deferred[i], nullptr);
				parts[i].nodes.shrink_to_fit();
				parts[i].blocks.shrink_to_fit();
			}
		});
		std::uint32_t deepest = 0;
		for (const Part& part : parts)
			deepest = std::max(deepest, part.stack);
		std::size_t node_total = top.nodes.size(), block_total = top.blocks.size();
		for (const Part& part : parts) {
			node_total += part.nodes.size();
			block_total += part.blocks.size();
		}
		// Their pages come as each part's go. Blocks will be put behind the nodes (with_bvh).
		top.nodes.reserve(node_total + block_total);
		top.blocks.reserve(block_total);
		// Links to deferred parts are numbered from deferred_link; now it is known where each begins.
		std::vector<std::uint32_t> links(deferred.size());
		const std::size_t node_rows = RT_BVH_NODE_ROWS(shape_.width), block_rows = RT_BVH_BLOCK_ROWS(shape_.width);
		const std::size_t top_nodes = top.nodes.size() / node_rows;
		for (std::size_t i = 0; i < parts.size(); ++i) {
			Part& part = parts[i];
			const auto first_node = static_cast<std::uint32_t>(top.nodes.size() / node_rows);
			const auto first_block = static_cast<std::uint32_t>(top.blocks.size() / block_rows);
			const auto moved = [&](std::uint32_t link) {
				if (link == RT_BVH_NONE)
					return link;
				if ((link & RT_BVH_LEAF) == 0)
					return link + first_node;
				return shape_.blocks ? link + first_block : link;
			};
			for (std::size_t node = 0; node < part.nodes.size(); node += node_rows)
				for (std::uint32_t k = 0; k < shape_.width; ++k) {
					float& link = element(part.nodes, node + 6 * shape_.width / 4, k);
					link = from_bits(moved(to_bits(link)));
				}
			links[i] = moved(roots[i]);
			top.nodes.insert(top.nodes.end(), part.nodes.begin(), part.nodes.end());
			top.blocks.insert(top.blocks.end(), part.blocks.begin(), part.blocks.end());
			top.visited_area += part.visited_area;
			top.tested_area += part.tested_area;
			part = Part();
		}
		const auto found = [&](std::uint32_t link) {
			return link >= deferred_link && link < deferred_link + links.size() ? links[link - deferred_link] : link;
		};
		*root = found(*root);
		for (std::size_t node = 0; node < top_nodes; ++node)
			for (std::uint32_t k = 0; k < shape_.width; ++k) {
				float& link = element(top.nodes, node * node_rows + 6 * shape_.width / 4, k);
				link = from_bits(found(to_bits(link)));
			}
		top.stack += deepest;
		return top;
	}

private:
	// No node has such a number: there are fewer nodes than spheres, and those are fewer than 2^27.
	static constexpr std::uint32_t deferred_link = 0x40000000u;

	// Adds the tree of a range and returns its link. Where `deferred` is given, ranges of shared_size_ items or fewer
	// are put there for later.
	std::uint32_t add(Part& part, const Range& range, std::vector<Range>* deferred)
	{
		if (deferred && range.size() <= shared_size_) {
			deferred->push_back(range);
			return deferred_link + static_cast<std::uint32_t>(deferred->size() - 1);
		}
		const std::vector<Range> parts = children(range);
		if (parts.size() == 1)
			return add_leaf(part, range);

		const std::size_t width = shape_.width, vector_rows = width / 4;
		const std::size_t first_row = part.nodes.size();
		const auto number = static_cast<std::uint32_t>(first_row / RT_BVH_NODE_ROWS(width));
		part.nodes.resize(first_row + RT_BVH_NODE_ROWS(width));
		part.visited_area += range.box.half_area();
		std::uint32_t stack = 0;
		for (std::size_t k = 0; k < width; ++k) {
			// A box that nothing meets, and whose planes overflow nowhere.
			std::array<float, 4> low = {0x1p60f, 0x1p60f, 0x1p60f}, high = {-0x1p60f, -0x1p60f, -0x1p60f};
			std::uint32_t link = RT_BVH_NONE;
			if (k < parts.size()) {
				low = parts[k].box.low;
				high = parts[k].box.high;
				part.stack = 0;
				link = add(part, parts[k], deferred);
				stack = std::max(stack, part.stack);
			}
			for (Axis a = 0; a < 3; ++a) {
				element(part.nodes, first_row + 2 * a * vector_rows, k) = low[a];
				element(part.nodes, first_row + (2 * a + 1) * vector_rows, k) = high[a];
			}
			element(part.nodes, first_row + 6 * vector_rows, k) = from_bits(link);
		}
		// Below one child its own wait, and above them all other children.
		part.stack = stack + static_cast<std::uint32_t>(parts.size()) - 1;
		return number;
	}

	std::uint32_t add_leaf(Part& part, const Range& range) const
	{
		part.stack = 1;
		const auto first = static_cast<std::uint32_t>(range.begin) + first_stored_;
		const auto count = static_cast<std::uint32_t>(range.size());
		part.tested_area += range.box.half_area() * shape_.cost(count);
		if (!shape_.blocks)
			return RT_BVH_LEAF | (count - 1) << RT_BVH_COUNT_SHIFT | first;
		const std::size_t row = part.blocks.size(), width = shape_.width;
		part.blocks.resize(row + RT_BVH_BLOCK_ROWS(width));
		part.blocks[row].a = from_bits(first);
		part.blocks[row].b = from_bits(count);
		return RT_BVH_LEAF | static_cast<std::uint32_t>(row / RT_BVH_BLOCK_ROWS(width));
	}

	// The children of a node: the range is cut, then always the child with the largest area, until there are as many
	// as fit. A single child means a leaf.
	std::vector<Range> children(const Range& range)
	{
		std::vector<Range> parts = {range};
		std::vector<bool> whole = {false};
		while (parts.size() < shape_.width) {
			std::size_t largest = parts.size();
			for (std::size_t i = 0; i < parts.size(); ++i)
				if (!whole[i] && parts[i].size() > 1 &&
				    (largest == parts.size() || parts[i].box.half_area() > parts[largest].box.half_area()))
					largest = i;
			if (largest == parts.size())
				break;
			Range left, right;
			if (!cut(parts[largest], left, right)) {
				whole[largest] = true;
				continue;
			}
			parts[largest] = left;
			parts.insert(parts.begin() + static_cast<std::ptrdiff_t>(largest) + 1, right);
			whole.insert(whole.begin() + static_cast<std::ptrdiff_t>(largest) + 1, false);
		}
		return parts;
	}

	// Cuts a range in two by the surface area heuristic; false if it is better left whole and fits a leaf.
	bool cut(const Range& range, Range& left, Range& right)
	{
		const bool fits = range.size() <= shape_.leaf;
		// A block costs one test however full it is.
		if (fits && shape_.blocks)
			return false;
		const Box centers = center_bounds(range);
		const Cut best = range.depth < sah_depth_ ? best_cut(range, centers) : Cut{};
		if (best.found) {
			const double area = range.box.half_area();
			if (fits && shape_.node_cost * area + best.cost >= shape_.cost(range.size()) * area)
				return false;
			const std::size_t position = partition(range, best);
			left = {range.begin, position, best.left, range.depth + 1};
			right = {position, range.end, best.right, range.depth + 1};
			return true;
		}
		if (fits)
			return false;
		halve(range, centers, left, right);
		return true;
	}

	// Moves the items that go left before the others and returns where the others begin. Pieces are of one size whoever
	// does them, so that the order is one.
	std::size_t partition(const Range& range, const Cut& by)
	{
		const auto cut_piece = [&](std::size_t begin, std::size_t end) {
			const auto middle = std::partition(at(begin), at(end), [&](const Item& item) {
				return bin_of(item.center[by.axis], by.low, by.scale) <= by.bin;
			});
			return static_cast<std::size_t>(middle - items_.begin());
		};
		if (range.size() <= shared_size_)
			return cut_piece(range.begin, range.end);

		std::vector<Piece> pieces;
		for (std::size_t begin = range.begin; begin < range.end; begin += min_parallel_items)
			pieces.push_back({begin, begin, std::min(begin + min_parallel_items, range.end)});
		parallel_for(pieces.size(), 1, [&](std::uint64_t first, std::uint64_t last) {
			for (std::uint64_t i = first; i < last; ++i)
				pieces[i].middle = cut_piece(pieces[i].begin, pieces[i].end);
		});
		std::size_t middle = range.begin;
		for (const Piece& piece : pieces)
			middle += piece.middle - piece.begin;

		// As many lie left of the middle that should not as right of it: they change places, run by run.
		auto from = pieces.begin(), to = pieces.begin();
		std::size_t wrong_left = from->middle, wrong_right = middle;
		for (;;) {
			while (from != pieces.end() && wrong_left >= std::min(from->end, middle))
				wrong_left = ++from == pieces.end() ? middle : from->middle;
			if (wrong_left >= middle)
				return middle;
			while (wrong_right >= std::max(to->middle, middle))
				wrong_right = std::max((++to)->begin, middle);
			const std::size_t run = std::min(std::min(from->end, middle) - wrong_left, to->middle - wrong_right);
			std::swap_ranges(at(wrong_left), at(wrong_left + run), at(wrong_right));
			wrong_left += run;
			wrong_right += run;
		}
	}

	std::vector<Item>::iterator at(std::size_t index) { return items_.begin() + static_cast<std::ptrdiff_t>(index); }

	Box center_bounds(const Range& range) const
	{
		return merged<Box>(range.begin, range.end, [&](Box& box, std::size_t i) { box.add(items_[i].center); });
	}

	// add(sum, index) for each of the items, by one thread or several, and the sums added up.
	template <class Sum, class Add>
	Sum merged(std::size_t begin, std::size_t end, const Add& add) const
	{
		if (end - begin > shared_size_)
			return merged_by_all<Sum>(begin, end, add);
		Sum sum;
		for (std::size_t i = begin; i < end; ++i)
			add(sum, i);
		return sum;
	}

	Cut best_cut(const Range& range, const Box& centers) const
	{
		std::array<float, 3> scale{};
		for (Axis a = 0; a < 3; ++a) {
			const float extent = centers.high[a] - centers.low[a];
			// An extent so small that the quotient overflows cannot be cut.
			scale[a] = extent > 0 ? static_cast<float>(bin_count) / extent : 0.0f;
			if (!std::isfinite(scale[a]))
				scale[a] = 0;
		}
		const Bins all = merged<Bins>(range.begin, range.end, [&](Bins& sum, std::size_t i) {
			for (Axis a = 0; a < 3; ++a) {
				Bin& bin = sum.bins[a][bin_of(items_[i].center[a], centers.low[a], scale[a])];
				bin.box.add(items_[i]);
				++bin.count;
			}
		});
		Cut best;
		for (Axis a = 0; a < 3; ++a) {
			if (scale[a] == 0)
				continue;
			const std::array<Bin, bin_count>& bins = all.bins[a];
			std::array<Bin, bin_count> rights; // of a cut behind each bin
			for (std::size_t b = bin_count - 1; b-- > 0;) {
				rights[b] = rights[b + 1];
				rights[b].add(bins[b + 1]);
			}
			Bin left;
			for (std::size_t b = 0; b < bin_count; ++b) {
				if (!bins[b].count) // nothing, or the cut before it
					continue;
				left.add(bins[b]);
				const Bin& right = rights[b];
				if (!right.count)
					break;
				const double cost =
				    left.box.half_area() * shape_.cost(left.count) + right.box.half_area() * shape_.cost(right.count);
				if (!best.found || cost < best.cost)
					best = {a, b, centers.low[a], scale[a], true, cost, left.box, right.box};
			}
		}
		return best;
	}

	// By the middle item along the longest axis; ties by where they were stored, so that the order is one.
	void halve(const Range& range, const Box& centers, Range& left, Range& right)
	{
		Axis longest = 0;
		for (Axis a = 1; a < 3; ++a)
			if (centers.high[a] - centers.low[a] > centers.high[longest] - centers.low[longest])
				longest = a;
		const std::size_t middle = range.begin + range.size() / 2;
		std::nth_element(at(range.begin), at(middle), at(range.end), [&](const Item& a, const Item& b) {
			return a.center[longest] != b.center[longest] ? a.center[longest] < b.center[longest] : a.source < b.source;
		});
		left = {range.begin, middle, box_of(range.begin, middle), range.depth + 1};
		right = {middle, range.end, box_of(middle, range.end), range.depth + 1};
	}

	Box box_of(std::size_t begin, std::size_t end) const
	{
		return merged<Box>(begin, end, [&](Box& box, std::size_t i) { box.add(items_[i]); });
	}

	std::vector<Item>& items_;
	Shape shape_;
	std::uint32_t first_stored_;
	std::uint32_t sah_depth_;
	std::size_t shared_size_;
};

} // namespace

Result<PackedScene> with_bvh(const PackedScene& packed, std::uint32_t lanes, BvhStats* stats)
{
	try {
		const auto start = std::chrono::steady_clock::now();
		const std::size_t wide = packed.wide.size(), count = packed.spheres.size() - wide;
		if (count == 0)
			return packed;

		const std::array<float, 3> center = center_of(packed);
		float extent = 0;
		std::vector<Item> items = items_of(packed, center, &extent);
		Shape shape;
		shape.width = RT_BVH_WIDTH(lanes);
		shape.blocks = lanes > 1;
		shape.leaf = shape.blocks ? lanes : max_leaf_in_turn;
		shape.node_cost = shape.blocks ? 1 : node_cost_in_turn;
		std::uint32_t root = RT_BVH_NONE;
		const auto first_stored = static_cast<std::uint32_t>(wide);
		Part tree = Builder(items, shape, first_stored, sah_depth).build(&root);
		// A tree of halves is balanced: 2^27 spheres leave room on the stack.
		if (tree.stack > RT_BVH_STACK(lanes))
			tree = Builder(items, shape, first_stored, 0).build(&root);

		PackedScene out; // not before the tree stands: there are enough copies in memory while it grows
		out.reserve_spheres(packed.spheres.size());
		out = packed;
		// Store the spheres as the leaves want them.
		parallel_for(count, min_parallel_items, [&](std::uint64_t begin, std::uint64_t end) {
			for (std::uint64_t i = begin; i < end; ++i) {
				const std::uint32_t source = items[i].source;
				out.spheres[wide + i] = packed.spheres[source];
				out.sphere_ids[wide + i] = packed.sphere_ids[source];
				out.sphere_materials[wide + i] = packed.sphere_materials[source];
			}
		});
		follow_spheres(packed, out);
		if (shape.blocks)
			fill_blocks(tree, out, shape.width);
		out.scene.bvh_root = root;
		out.scene.bvh_blocks = static_cast<std::uint32_t>(tree.nodes.size());
		out.scene.bvh_x = center[0];
		out.scene.bvh_y = center[1];
		out.scene.bvh_z = center[2];
		out.scene.bvh_extent = extent;
		std::vector<Item>().swap(items);
		out.bvh = std::move(tree.nodes);
		out.bvh.insert(out.bvh.end(), tree.blocks.begin(), tree.blocks.end());
		out.features |= bvh_features;
		if (stats) {
			const double area = std::max(tree.area, 1e-300);
			stats->nodes = out.scene.bvh_blocks / RT_BVH_NODE_ROWS(shape.width);
			stats->stack = tree.stack;
			stats->node_visits = tree.visited_area / area;
			stats->sphere_tests = tree.tested_area / area;
			stats->bytes = out.bvh.size() * sizeof(rt_row4);
			stats->seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
		}
		return out;
	} catch (const std::bad_alloc&) {
		return Error{ErrorKind::Memory,
		             fmt::format("there is no memory for the tree of {} spheres", packed.spheres.size()),
		             {},
		             "render fewer spheres, or on a machine with more memory",
		             {}};
	}
}

std::uint64_t bvh_bytes_needed(std::uint64_t spheres, std::uint32_t lanes)
{
	// A leaf may hold a single sphere, and a node two children.
	const std::uint64_t width = RT_BVH_WIDTH(lanes);
	const std::uint64_t rows =
	    lanes == 1 ? RT_BVH_NODE_ROWS(width) / 2 : RT_BVH_NODE_ROWS(width) + RT_BVH_BLOCK_ROWS(width);
	return lanes == 1 ? spheres * rows * sizeof(rt_row4) : 2 * spheres / width * rows * sizeof(rt_row4);
}

} // namespace rt
