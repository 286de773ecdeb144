#include "support/deflate.h"

#include "support/thread_pool.h"

#include <algorithm>
#include <new>
#include <stdexcept>

#include <zlib.h>

namespace rt {

namespace {

constexpr std::size_t piece_bytes = std::size_t(1) << 17, window_bytes = std::size_t(1) << 15;
// Noise, which most of our images are full of, hardly gets smaller for more effort.
constexpr int level = Z_BEST_SPEED;

struct Piece {
	std::vector<std::uint8_t> bytes;
	uLong adler = 0;
};

// Deflated bytes of one piece, which end at a byte's boundary.
Piece compress_piece(const std::uint8_t* data, std::size_t first, std::size_t end, bool last)
{
	Piece piece;
	z_stream stream{};
	// Negative: without the header and the checksum of a whole stream.
	if (deflateInit2(&stream, level, Z_DEFLATED, -MAX_WBITS, MAX_MEM_LEVEL, Z_DEFAULT_STRATEGY) != Z_OK)
		throw std::bad_alloc(); // the only thing that such constants can lack
	try {
		const std::size_t known = std::min(first, window_bytes);
		if (known && deflateSetDictionary(&stream, data + first - known, static_cast<uInt>(known)) != Z_OK)
			throw std::logic_error("deflateSetDictionary");
		// The marker that a piece but the last ends with takes a few bytes more than deflateBound knows of.
		piece.bytes.resize(deflateBound(&stream, static_cast<uLong>(end - first)) + 16);
		stream.next_in = const_cast<Bytef*>(data + first);
		stream.avail_in = static_cast<uInt>(end - first);
		stream.next_out = piece.bytes.data();
		stream.avail_out = static_cast<uInt>(piece.bytes.size());
		// A piece that did not fit would be cut off within.
		if (deflate(&stream, last ? Z_FINISH : Z_SYNC_FLUSH) != (last ? Z_STREAM_END : Z_OK) || stream.avail_in != 0 ||
		    stream.avail_out == 0)
			throw std::logic_error("deflate");
		piece.bytes.resize(stream.total_out);
		piece.adler = adler32_z(adler32_z(0, nullptr, 0), data + first, end - first);
	} catch (...) {
		deflateEnd(&stream);
		throw;
	}
	deflateEnd(&stream);
	return piece;
}

} // namespace

std::vector<std::uint8_t> zlib_compress(const std::uint8_t* data, std::size_t bytes)
{
	const std::size_t count = std::max<std::size_t>(1, (bytes + piece_bytes - 1) / piece_bytes);
	std::vector<Piece> pieces(count);
	parallel_for(count, 1, [&](std::uint64_t begin, std::uint64_t end) {
		for (std::size_t i = begin; i < end; ++i)
			pieces[i] = compress_piece(data, i * piece_bytes, std::min(bytes, (i + 1) * piece_bytes), i + 1 == count);
	});

	std::vector<std::uint8_t> stream = {0x78, 0x01}; // deflate with a window of 32 KiB, compressed for speed
	std::size_t total = stream.size() + 4;
	for (const Piece& piece : pieces)
		total += piece.bytes.size();
	stream.reserve(total);
	uLong adler = adler32_z(0, nullptr, 0);
	for (std::size_t i = 0; i < count; ++i) {
		stream.insert(stream.end(), pieces[i].bytes.begin(), pieces[i].bytes.end());
		const std::size_t length = std::min(bytes, (i + 1) * piece_bytes) - i * piece_bytes;
		adler = adler32_combine(adler, pieces[i].adler, static_cast<z_off_t>(length));
	}
	for (int shift = 24; shift >= 0; shift -= 8)
		stream.push_back(static_cast<std::uint8_t>(adler >> shift));
	return stream;
}

} // namespace rt
