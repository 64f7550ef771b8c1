/* Decodes messages with opendroneid-core-c. Each line of the input is a message or pack in hexadecimal; each line of
 * the output is what the library made of it: its type, or -1, and for packs those of its messages. */
#include <opendroneid.h>
#include <stdio.h>
#include <string.h>

static void one(const uint8_t *raw) {
    static ODID_UAS_Data data;
    odid_initUasData(&data);
    int type = decodeOpenDroneID(&data, raw);
    printf(" %d", type == ODID_MESSAGETYPE_INVALID ? -1 : type);
    if (type == ODID_MESSAGETYPE_BASIC_ID) {
        printf(":%d:", data.BasicID[0].IDType);
        for (int i = 0; i < ODID_ID_SIZE; i++) printf("%02x", (uint8_t) data.BasicID[0].UASID[i]);
    } else if (type == ODID_MESSAGETYPE_LOCATION) {
        printf(":%.7f:%.7f", data.Location.Latitude, data.Location.Longitude);
    } else if (type == ODID_MESSAGETYPE_AUTH) {
        for (int page = 0; page < ODID_AUTH_MAX_PAGES; page++) {
            const ODID_Auth_data *auth = &data.Auth[page];
            if (!data.AuthValid[page]) continue;
            printf(":%d:%d:%d:%d:%u:", auth->AuthType, auth->DataPage, auth->LastPageIndex, auth->Length,
                   auth->Timestamp);
            for (int i = 0; i < (page ? 23 : 17); i++) printf("%02x", auth->AuthData[i]);
        }
    }
}

int main(void) {
    char line[1024];
    while (fgets(line, sizeof line, stdin)) {
        uint8_t raw[512] = {0};
        int size = 0;
        for (unsigned value; size < 512 && sscanf(line + 2 * size, "%2x", &value) == 1; size++) raw[size] = value;
        if (raw[0] >> 4 == ODID_MESSAGETYPE_PACKED) {
            static ODID_UAS_Data data;
            odid_initUasData(&data);
            printf("%d", odid_message_process_pack(&data, raw, size) < 0 ? -1 : ODID_MESSAGETYPE_PACKED);
            for (int at = 3; at + 25 <= size; at += 25) one(raw + at);
        } else {
            one(raw);
        }
        printf("\n");
    }
    return 0;
}
