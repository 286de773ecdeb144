#include "render/texture_decoders.h"

#include <cstdio> // jpeglib.h needs FILE and does not include it

#include <jerror.h>
#include <jpeglib.h>

#include <csetjmp>
#include <cstring>

namespace rt {

namespace {

// A progressive file may ask for any number of passes over the picture, which is a way to keep a reader busy for hours
// (libjpeg-turbo's own advice is to limit them).
constexpr int max_scans = 200;

// libjpeg's error manager, extended by where to jump and what was said: plain data, because errors jump.
struct JpegErrors {
	jpeg_error_mgr manager; // first, so that a pointer to it is a pointer to this
	std::jmp_buf jump;
	char message[JMSG_LENGTH_MAX];
};

JpegErrors* errors_of(j_common_ptr jpeg) { return reinterpret_cast<JpegErrors*>(jpeg->err); }

[[noreturn]] void fail(j_common_ptr jpeg)
{
	JpegErrors* errors = errors_of(jpeg);
	errors->manager.format_message(jpeg, errors->message);
	std::longjmp(errors->jump, 1);
}

// Warnings are level -1. Those that say that picture data is missing are errors: the decoder would go on in grey.
void hear_message(j_common_ptr jpeg, int level)
{
	const int code = jpeg->err->msg_code;
	if (level < 0 && (code == JWRN_JPEG_EOF || code == JWRN_HIT_MARKER || code == JWRN_HUFF_BAD_CODE))
		fail(jpeg);
}

void ignore_output(j_common_ptr) {}

void watch_progress(j_common_ptr jpeg)
{
	if (jpeg->is_decompressor && reinterpret_cast<j_decompress_ptr>(jpeg)->input_scan_number > max_scans) {
		JpegErrors* errors = errors_of(jpeg);
		std::snprintf(errors->message, sizeof errors->message, "more than %d scans", max_scans);
		std::longjmp(errors->jump, 1);
	}
}

// Owns the decompressor; a failed read leaves it fit to be destroyed.
struct JpegReader {
	JpegReader()
	{
		std::memset(&jpeg, 0, sizeof jpeg);
		jpeg.err = jpeg_std_error(&errors.manager);
		errors.manager.error_exit = fail;
		errors.manager.emit_message = hear_message;
		errors.manager.output_message = ignore_output;
		progress.progress_monitor = watch_progress;
	}
	~JpegReader() { jpeg_destroy_decompress(&jpeg); }
	JpegReader(const JpegReader&) = delete;
	JpegReader& operator=(const JpegReader&) = delete;

	jpeg_decompress_struct jpeg;
	JpegErrors errors{};
	jpeg_progress_mgr progress{};
};

bool read_header(JpegReader& reader, const std::uint8_t* data, std::size_t bytes)
{
	if (setjmp(reader.errors.jump))
		return false;
	jpeg_create_decompress(&reader.jpeg);
	reader.jpeg.progress = &reader.progress;
	jpeg_mem_src(&reader.jpeg, data, static_cast<unsigned long>(bytes));
	jpeg_read_header(&reader.jpeg, TRUE);
	return true;
}

// Huffman codes are a bit or longer, and every block of 8 x 8 has one at least (ITU-T T.81, F.1.2 and G.1.2), so a
// short file that claims a large picture is refused before memory is taken for it: a progressive one is held as a
// whole.
bool long_enough(const jpeg_decompress_struct& jpeg, std::size_t file_bytes)
{
	const std::uint64_t blocks = std::uint64_t(jpeg.image_width / 8) * (jpeg.image_height / 8);
	return jpeg.arith_code || blocks / 8 <= file_bytes;
}

// Choices that every libjpeg computes alike: the slow integer transform and plain replication of chroma; what depends
// on a version's taste (smoothing, fancy upsampling) is off.
bool start(JpegReader& reader)
{
	if (setjmp(reader.errors.jump))
		return false;
	reader.jpeg.out_color_space = JCS_RGB;
	reader.jpeg.dct_method = JDCT_ISLOW;
	reader.jpeg.do_fancy_upsampling = FALSE;
	reader.jpeg.do_block_smoothing = FALSE;
	jpeg_start_decompress(&reader.jpeg);
	return true;
}

bool read_row(JpegReader& reader, std::uint8_t* rgb)
{
	if (setjmp(reader.errors.jump))
		return false;
	JSAMPROW rows[1] = {rgb};
	jpeg_read_scanlines(&reader.jpeg, rows, 1);
	return true;
}

bool finish(JpegReader& reader)
{
	if (setjmp(reader.errors.jump))
		return false;
	jpeg_finish_decompress(&reader.jpeg);
	return true;
}

} // namespace

Result<TextureImage> decode_jpeg(const std::uint8_t* data, std::size_t bytes, const std::string& name)
{
	JpegReader reader;
	const auto broken = [&] { return broken_texture("JPEG", reader.errors.message, name); };
	if (!read_header(reader, data, bytes))
		return broken();
	RT_TRY(check_texture_size(reader.jpeg.image_width, reader.jpeg.image_height, name));
	if (reader.jpeg.jpeg_color_space == JCS_CMYK || reader.jpeg.jpeg_color_space == JCS_YCCK)
		return Error{ErrorKind::InputOutput, "the JPEG file is CMYK, made for print", name, "convert it to RGB", {}};
	if (!long_enough(reader.jpeg, bytes))
		return broken_texture("JPEG", "the file is too short for a picture of its size", name);
	if (!start(reader))
		return broken();

	TextureImage image;
	image.width = reader.jpeg.output_width;
	image.height = reader.jpeg.output_height;
	std::vector<std::uint8_t> rgb(std::size_t(image.width) * 3);
	// Memory grows with the rows that are really there, whatever the header claims.
	for (std::uint32_t y = 0; y < image.height; ++y) {
		if (!read_row(reader, rgb.data()))
			return broken();
		for (std::size_t x = 0; x < image.width; ++x)
			image.texels.push_back(static_cast<std::uint32_t>(rgb[3 * x] | rgb[3 * x + 1] << 8 | rgb[3 * x + 2] << 16));
	}
	if (!finish(reader))
		return broken();
	return image;
}

} // namespace rt
