# Writes each command to the file $1, and ends at the value 66.
while read -r verb device control value rest; do
    case "$verb" in
        ping) ;;
        *) echo "$verb${device:+ $device}${control:+ $control}${value:+ $value}" >>"$1" ;;
    esac
    if [ "$value" = 66 ]; then exit 1; fi
    case "$verb" in
        read) echo 12.5 ;;
        *) echo ok ;;
    esac
done
