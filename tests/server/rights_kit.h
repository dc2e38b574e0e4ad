/* The file of --auth, for tests of who may read what.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_RIGHTS_KIT_H
#define TESTS_RIGHTS_KIT_H

#include "tests/server/client.h"

#include <nettle/base16.h>
#include <nettle/sha2.h>
#include <sys/stat.h>

#define TOKEN "a-token-that-nobody-guesses"
#define KEY "0123456789abcdef0123456789abcdef"

/* Writes a file beside the store; out is its path. */

static inline const char *rights_put(const char *name, const char *text, char out[FILE_PATH_MAX])
{
    struct err e = {0};
    kit_ok(file_join(out, t.dir, name, &e), e);
    kit_ok(file_write(out, text, strlen(text), &e), e);
    assert_int_equal(chmod(out, 0640), 0);
    return out;
}

/* Writes the file of --auth: one key, one token with these scopes, and what is public. */
static inline const char *rights_file(const char *scopes, const char *open, char out[FILE_PATH_MAX])
{
    struct sha256_ctx h;
    uint8_t digest[SHA256_DIGEST_SIZE];
    char hex[2 * SHA256_DIGEST_SIZE + 1] = "", text[600];
    sha256_init(&h);
    sha256_update(&h, strlen(TOKEN), (const uint8_t *)TOKEN);
    sha256_digest(&h, sizeof digest, digest);
    base16_encode_update(hex, sizeof digest, digest);
    snprintf(text, sizeof text,
             "// who may read\n{\"keys\": {\"k1\": \"%s\"}, \"tokens\": [{\"sha256\": \"%s\", "
             "\"scope\": [%s]}], "
             "\"public\": [%s]}\n",
             KEY, hex, scopes, open);
    return rights_put("auth.jsonc", text, out);
}

#endif
