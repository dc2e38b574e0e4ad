/* Zip archives: see archive.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/archive.h"

#include <zip.h>

enum { ARCHIVE_DATE = 0x21 /* 1980-01-01 as MS-DOS has it */ };

struct archive_reader {
    zip_t *archive;
};

static enum err_code archive_fail(zip_error_t *why, struct err *e)
{
    enum err_code rc = zip_error_code_zip(why) == ZIP_ER_MEMORY
                           ? err_set(e, ERR_MEM, "zip: out of memory")
                           : err_set(e, ERR_INTERNAL, "zip: %s", zip_error_strerror(why));
    zip_error_fini(why);
    return rc;
}

/* false: see zip_get_error. */
static bool archive_add(zip_t *z, const struct archive_part *part)
{
    zip_source_t *from = zip_source_buffer(z, part->bytes.data, part->bytes.size, 0);
    if (!from)
        return false;
    zip_int64_t at = zip_file_add(z, part->name, from, ZIP_FL_ENC_UTF_8);
    if (at < 0) {
        zip_source_free(from);
        return false;
    }
    return zip_set_file_compression(z, (zip_uint64_t)at, ZIP_CM_STORE, 0) == 0 &&
           zip_file_set_dostime(z, (zip_uint64_t)at, 0, ARCHIVE_DATE, 0) == 0;
}

static enum err_code archive_take(zip_source_t *all, struct buf *out, struct err *e)
{
    zip_stat_t st;
    if (zip_source_stat(all, &st) != 0 || !(st.valid & ZIP_STAT_SIZE) || zip_source_open(all) != 0)
        return archive_fail(zip_source_error(all), e);
    uint8_t *at = buf_grow(out, st.size);
    zip_int64_t got = at ? zip_source_read(all, at, st.size) : 0;
    zip_source_close(all);
    if (at && (zip_uint64_t)got != st.size)
        return err_set(e, ERR_INTERNAL, "zip: %lld bytes of %llu", (long long)got,
                       (unsigned long long)st.size);
    return buf_check(out, e);
}

enum err_code archive_write(const struct archive_part *part, size_t n, struct buf *out,
                            struct err *e)
{
    zip_error_t why;
    zip_error_init(&why);
    zip_source_t *all = zip_source_buffer_create(NULL, 0, 0, &why);
    if (!all)
        return archive_fail(&why, e);
    zip_source_keep(all); /* zip_close takes one reference */
    zip_t *z = zip_open_from_source(all, ZIP_TRUNCATE, &why);
    if (!z) {
        zip_source_free(all);
        zip_source_free(all);
        return archive_fail(&why, e);
    }
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++)
        if (!archive_add(z, &part[i]))
            rc = err_set(e, ERR_MEM, "zip: %s: %s", part[i].name, zip_strerror(z));
    if (!rc && zip_close(z) != 0)
        rc = err_set(e, ERR_INTERNAL, "zip: %s", zip_strerror(z));
    else if (!rc)
        z = NULL;
    if (!rc)
        rc = archive_take(all, out, e);
    if (z)
        zip_discard(z);
    zip_source_free(all);
    return rc;
}

enum err_code archive_open(const void *bytes, size_t n, struct archive_reader **out, struct err *e)
{
    zip_error_t why;
    zip_error_init(&why);
    struct archive_reader *z = mem_array(1, sizeof *z);
    zip_source_t *from = z ? zip_source_buffer_create(bytes, n, 0, &why) : NULL;
    z = from ? z : (mem_free(z), NULL);
    *out = NULL;
    if (!z)
        return err_set(e, ERR_MEM, "zip: out of memory");
    z->archive = zip_open_from_source(from, ZIP_RDONLY, &why);
    if (!z->archive) {
        enum err_code rc = zip_error_code_zip(&why) == ZIP_ER_MEMORY
                               ? err_set(e, ERR_MEM, "zip: out of memory")
                               : err_set(e, ERR_FORMAT, "zip: %s", zip_error_strerror(&why));
        zip_error_fini(&why);
        zip_source_free(from);
        mem_free(z);
        return rc;
    }
    *out = z;
    return ERR_OK;
}

enum err_code archive_get(struct archive_reader *z, const char *name, size_t most, struct buf *out,
                          struct err *e)
{
    zip_stat_t st;
    if ((zip_stat(z->archive, name, 0, &st) != 0 &&
         zip_stat(z->archive, name, ZIP_FL_NODIR, &st) != 0) ||
        !(st.valid & ZIP_STAT_SIZE))
        return err_set(e, ERR_FORMAT, "zip: %s is missing", name);
    if (st.size > most)
        return err_set(e, ERR_LIMIT, "zip: %s: %llu bytes: %zu are expected at most", name,
                       (unsigned long long)st.size, most);
    zip_file_t *f = zip_fopen_index(z->archive, st.index, 0);
    if (!f)
        return err_set(e, ERR_FORMAT, "zip: %s: %s", name, zip_strerror(z->archive));
    uint8_t *at = buf_grow(out, st.size);
    zip_int64_t got = at ? zip_fread(f, at, st.size) : 0;
    int bad = zip_fclose(f);
    enum err_code rc = buf_check(out, e);
    if (!rc && ((zip_uint64_t)got != st.size || bad))
        rc = err_set(e, ERR_FORMAT, "zip: %s is damaged", name);
    if (rc)
        buf_free(out);
    return rc;
}

void archive_close(struct archive_reader **z)
{
    if (*z) {
        zip_discard((*z)->archive);
        mem_free(*z);
    }
    *z = NULL;
}
